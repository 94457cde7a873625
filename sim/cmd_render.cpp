// csipose-sim render: a scene as a picture or a film.
#include <fmt/core.h>

#include <CLI/CLI.hpp>
#include <cmath>
#include <memory>
#include <opencv2/imgcodecs.hpp>
#include <opencv2/videoio.hpp>

#include "proto/result.h"
#include "sim/atomic_file.h"
#include "sim/commands.h"
#include "sim/mesh_scene.h"
#include "sim/picture.h"
#include "sim/scene_options.h"

namespace csipose::sim {
namespace {
namespace fs = std::filesystem;

struct RenderOptions {
  SceneOptions scene;
  fs::path stated, out;
  double at_s = 2, seconds = 0, frames_per_s = 30, past_s = 2;
  PictureOptions picture;
  bool no_skeletons = false, no_bodies = false;
};

ScenePlayer open_scene(const RenderOptions& options) {
  if (!options.stated.empty()) {
    const Scene scene = read_scene_with_meshes(options.stated);
    if (!scene.mesh_bodies.empty())
      throw SetupError(
          ExitStatus::usage,
          fmt::format("{}: has bodies that are meshes; these are solved (solve --scatter po), not drawn",
                      options.stated.string()));
    return {stated_scene(scene), scene.step_s, options.past_s};
  }
  auto scene = open_moving_scene(options.scene);
  if (!scene)
    throw SetupError(ExitStatus::usage,
                     "the reflector is a formula, without a room to be drawn; choose another --scene");
  return {std::move(scene), 1 / options.scene.rate_hz, options.past_s};
}

std::string title_of(const RenderOptions& options) {
  if (!options.stated.empty()) return options.stated.stem().string();
  const SceneOptions& scene = options.scene;
  return fmt::format("csipose-sim: {}, seed {}, clip {}", scene.scene, scene.seed, scene.clip);
}

/// A film under another name until it is whole.
class Film {
 public:
  Film(fs::path target, double frames_per_s, cv::Size size) : target_(std::move(target)), part_(target_) {
    part_.replace_filename("." + target_.stem().string() + ".part.mp4");
    // What browsers play, or else what every player does.
    for (const int code :
         {cv::VideoWriter::fourcc('a', 'v', 'c', '1'), cv::VideoWriter::fourcc('m', 'p', '4', 'v')})
      if (!writer_.isOpened()) writer_.open(part_.string(), code, frames_per_s, size);
    if (!writer_.isOpened())
      throw SetupError(ExitStatus::cannot_create,
                       fmt::format("cannot write the film {}: the folder does not allow it, or OpenCV here "
                                   "has no encoder for MP4; a "
                                   "picture ends in .png",
                                   target_.string()));
  }
  ~Film() {
    writer_.release();
    std::error_code ignored;
    fs::remove(part_, ignored);
  }
  Film(const Film&) = delete;
  Film& operator=(const Film&) = delete;
  void add(const cv::Mat& picture) { writer_.write(picture); }
  void commit() {
    writer_.release();
    std::error_code error;
    fs::rename(part_, target_, error);
    if (error)
      throw SetupError(ExitStatus::io, fmt::format("cannot give the film its name {}: {}", target_.string(),
                                                   error.message()));
  }

 private:
  fs::path target_, part_;
  cv::VideoWriter writer_;
};

std::size_t snapshot_at(double t_s, const ScenePlayer& player) {
  return static_cast<std::size_t>(std::lround(t_s / player.step_s()));
}

void write_film(const RenderOptions& options, const Picture& picture, ScenePlayer& player) {
  Film film(options.out, options.frames_per_s, {options.picture.width, options.picture.height});
  const int frames = std::max(1, static_cast<int>(std::lround(options.seconds * options.frames_per_s)));
  for (int i = 0; i < frames; ++i) {
    player.run_to(snapshot_at(options.at_s + i / options.frames_per_s, player));
    film.add(picture.draw(player));
  }
  film.commit();
  fmt::print("{}: {} pictures, {} a second\n", options.out.string(), frames, options.frames_per_s);
}

void write_picture(const RenderOptions& options, const Picture& picture, ScenePlayer& player) {
  AtomicFile out(options.out);
  player.run_to(snapshot_at(options.at_s, player));
  std::vector<std::uint8_t> png;
  cv::imencode(".png", picture.draw(player), png);
  out.write(png);
  out.commit();
  fmt::print("{}: {} x {}, t = {:.3f} s\n", options.out.string(), options.picture.width,
             options.picture.height, player.time_s());
}

void render(RenderOptions options) {
  const bool is_film = options.out.extension() == ".mp4";
  if (!is_film && options.out.extension() != ".png")
    throw SetupError(ExitStatus::usage,
                     fmt::format("{} is neither a picture (.png) nor a film (.mp4)", options.out.string()));
  if (is_film && options.seconds <= 0) options.seconds = 4;
  options.picture.skeletons = !options.no_skeletons;
  options.picture.bodies = !options.no_bodies;
  if (options.picture.title.empty()) options.picture.title = title_of(options);
  ScenePlayer player = open_scene(options);
  const Picture picture(player.still(), player.people_count(), options.picture);
  is_film ? write_film(options, picture, player) : write_picture(options, picture, player);
}

}  // namespace

void add_render(CLI::App& app) {
  auto options = std::make_shared<RenderOptions>();
  CLI::App* command = app.add_subcommand(
      "render",
      "a scene as a picture (PNG) or a film (MP4): room, people, paths, and what the receivers see");
  command->add_option("stated", options->stated, "a scene file as solve takes it, instead of --scene");
  add_scene_options(*command, options->scene);
  command->add_option("--out", options->out, "file to write; .png or .mp4")->required();
  command->add_option("--at", options->at_s, "instant of the picture, start of the film, seconds")
      ->check(CLI::Range(0.0, 86400.0))
      ->capture_default_str();
  command->add_option("--seconds", options->seconds, "length of the film; 4 unless said")
      ->check(CLI::Range(0.0, 3600.0));
  command->add_option("--fps", options->frames_per_s, "pictures a second of the film")
      ->check(CLI::Range(1.0, 120.0))
      ->capture_default_str();
  command->add_option("--past", options->past_s, "seconds of the channel shown")
      ->check(CLI::Range(0.05, 60.0))
      ->capture_default_str();
  command
      ->add_option("--paths", options->picture.paths, "how many of the strongest paths are drawn; 0 = none")
      ->check(CLI::Range(0, 1000))
      ->capture_default_str();
  command->add_option("--width", options->picture.width, "pixels")
      ->check(CLI::Range(320, 3840))
      ->capture_default_str();
  command->add_option("--height", options->picture.height, "pixels")
      ->check(CLI::Range(180, 2160))
      ->capture_default_str();
  command
      ->add_option("--azimuth", options->picture.azimuth_deg,
                   "of the camera about the room; 0 looks from +x, 90 from +y")
      ->check(CLI::Range(-360.0, 360.0))
      ->capture_default_str();
  command->add_option("--elevation", options->picture.elevation_deg, "of the camera above the horizon")
      ->check(CLI::Range(0.0, 85.0))
      ->capture_default_str();
  command->add_option("--title", options->picture.title, "words over the picture");
  command->add_flag("--no-skeletons", options->no_skeletons, "without the labels");
  command->add_flag("--no-bodies", options->no_bodies, "labels, room and paths alone");
  command->callback([options] { render(*options); });
}

}  // namespace csipose::sim
