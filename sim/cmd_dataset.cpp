// csipose-sim dataset: frames for training, as NumPy arrays.
#include <fmt/core.h>
#include <fmt/ranges.h>
#include <malloc.h>
#include <unistd.h>

#include <CLI/CLI.hpp>
#include <chrono>
#include <climits>
#include <memory>
#include <numeric>
#include <thread>

#include "sim/commands.h"
#include "sim/human_clip.h"
#include "sim/object_clip.h"
#include "sim/scene_options.h"
#include "version.h"

namespace csipose::sim {
namespace {

/// What all kinds of sets ask for.
struct DatasetOptions {
  std::filesystem::path folder;
  std::uint32_t clips = 900, frames = 100;
  std::size_t snapshots = kSamples;
  double rate_hz = 300;
  std::uint64_t seed = 1;
  unsigned threads = std::max(1u, std::thread::hardware_concurrency());
  std::string store = "int8";
  RadioOptions radio;
  Ways ways;

  FrameFormat format() const { return {*find_storage(store), snapshots}; }
};

struct HumanOptions : DatasetOptions {
  std::string room = "random";
  std::size_t least_people = 1, most_people = 3;
  PeopleOptions who;
};

struct SimPiwOptions : DatasetOptions {
  bool small = false;
};

/// One line on stderr: what is done, how fast, how long still. Rewritten in a terminal; elsewhere a line
/// every ten seconds.
class Progress {
  static constexpr double kLineEvery_s = 10;

 public:
  explicit Progress(const DatasetPlan& plan)
      : frames_(std::accumulate(plan.clip_frames.begin(), plan.clip_frames.end(), std::uint64_t{0})) {}
  void operator()(std::uint32_t done, std::uint32_t clips) {
    ++made_;
    const bool terminal = ::isatty(STDERR_FILENO) != 0;
    const double elapsed_s = std::chrono::duration<double>(std::chrono::steady_clock::now() - begin_).count();
    if (!terminal && elapsed_s < next_line_s_ && done != clips) return;
    next_line_s_ = elapsed_s + kLineEvery_s;
    const double clips_per_s = made_ / elapsed_s;
    fmt::print(stderr, "{}clip {} of {}, {:.0f} frames/s, {:.0f} s left{}", terminal ? "\r\x1b[K" : "", done,
               clips, clips_per_s * static_cast<double>(frames_) / clips, (clips - done) / clips_per_s,
               terminal && done != clips ? "" : "\n");
  }

 private:
  std::chrono::steady_clock::time_point begin_ = std::chrono::steady_clock::now();
  std::uint64_t frames_;
  double made_ = 0, next_line_s_ = 0;
};

std::map<std::string, std::string> made_by(const char* generator, const DatasetOptions& options) {
  return {{"generator", generator},
          {"seed", std::to_string(options.seed)},
          {"rate_hz", fmt::format("{}", options.rate_hz)},
          {"impair", options.format().storage == Storage::records ? options.radio.words() : "none"},
          {"store", options.store},
          {"pairs", std::to_string(options.ways.pairs)},
          {"clutter", options.ways.clutter ? "yes" : "no"},
          {"version", CSIPOSE_VERSION},
          {"commit", CSIPOSE_COMMIT}};
}

/// Makes what is missing, then the manifest.
void make_dataset(const DatasetPlan& plan, unsigned threads,
                  const std::function<ClipRows(std::uint32_t)>& make) {
  // Each clip takes a copy of its room's solver; without this glibc gives its pages back to the kernel after every one: a
  // quarter of the time where a clip is one snapshot.
  ::mallopt(M_MMAP_THRESHOLD, INT_MAX);
  ::mallopt(M_TRIM_THRESHOLD, INT_MAX);
  Dataset dataset(plan);
  Progress progress(plan);
  fill(dataset, threads, make, [&](std::uint32_t done, std::uint32_t clips) { progress(done, clips); });
  dataset.finish();
  fmt::print("{}: {} frames in {} clips\n", plan.folder.string(),
             std::accumulate(plan.clip_frames.begin(), plan.clip_frames.end(), std::uint64_t{0}),
             plan.clip_frames.size());
}

void make_object_dataset(const DatasetOptions& options) {
  DatasetPlan plan;
  plan.folder = options.folder;
  plan.clip_frames.assign(options.clips, options.frames);
  plan.arrays = frame_arrays(options.format());
  plan.splits = usual_splits(options.clips);
  plan.made_by = made_by("sim-object", options);
  const Impairments on = options.radio.impairments();
  make_dataset(plan, options.threads, [&](std::uint32_t clip) {
    const auto scene = object_scene(options.seed, clip, options.rate_hz, options.ways);
    return make_clip(*scene, options.format(), on, options.seed, clip, options.frames, options.rate_hz);
  });
}

DatasetPlan human_plan(const DatasetOptions& options, const std::vector<std::string>& rooms) {
  DatasetPlan plan;
  plan.folder = options.folder;
  plan.arrays = human_arrays(options.format());
  plan.names["room"] = rooms;
  plan.names["action"].assign(kActionNames.begin(), kActionNames.end());
  return plan;
}

/// As many people as the published test set has, by shares: 33, 41, 26 %; where fewer are asked for, the shares of these.
std::size_t draw_people(const HumanOptions& options, std::uint32_t clip) {
  static constexpr std::array kShares{0.33, 0.41, 0.26};
  CounterRng rng(options.seed, Purpose::persons, 1000, clip, 0);
  double all = 0;
  for (std::size_t n = options.least_people; n <= options.most_people; ++n) all += kShares[n - 1];
  double at = rng.uniform(0, all);
  std::size_t people = options.least_people;
  while (people < options.most_people && (at -= kShares[people - 1]) > 0) ++people;
  return people;
}

void make_human_dataset(const HumanOptions& options) {
  if (options.least_people > options.most_people)
    throw SetupError(ExitStatus::usage, fmt::format("--people {} {}: the first must not be the larger",
                                                    options.least_people, options.most_people));
  const bool random = options.room == "random";
  HumanSpec fixed;
  if (!random) fixed.room = read_room_plan(options.room);
  DatasetPlan plan = human_plan(options, {random ? "random" : fixed.room.name});
  plan.clip_frames.assign(options.clips, options.frames);
  plan.splits = usual_splits(options.clips);
  plan.made_by = made_by("sim-human", options);
  plan.made_by["room"] = options.room;
  plan.made_by["people"] = fmt::format("{}-{}", options.least_people, options.most_people);
  plan.made_by["actions"] = fmt::format("{}", fmt::join(options.who.actions, ","));
  plan.made_by["chairs"] = options.who.chairs ? "yes" : "no";
  plan.made_by["devices"] = random && options.who.opposite ? "opposite" : "as the room says";
  // Clutter is drawn for each clip: then no room serves two.
  const bool same_room = !random && !options.ways.clutter;
  set_ways(fixed.room.still, options.ways, options.seed, 0);
  const auto solver = same_room ? std::make_unique<FastSolver>(fixed.room.still) : nullptr;
  const Impairments on = options.radio.impairments();
  make_dataset(plan, options.threads, [&](std::uint32_t number) {
    HumanClip clip{fixed, number, options.frames, 0, solver.get()};
    if (random) clip.spec.room = draw_room(options.seed, number, options.who.opposite);
    clip.spec.people = draw_people(options, number);
    clip.spec.allowed = options.who.allowed();
    clip.spec.chairs = options.who.chairs;
    if (!same_room) set_ways(clip.spec.room.still, options.ways, options.seed, number);
    return make_human_clip(clip, options.format(), on, options.seed, options.rate_hz);
  });
}

void make_simpiw(const SimPiwOptions& options) {
  const std::vector<SimPiwClip> clips = simpiw_clips(options.small);
  DatasetPlan plan = human_plan(options, {kSimPiwRooms.begin(), kSimPiwRooms.end()});
  for (std::uint32_t i = 0; i < clips.size(); ++i) {
    plan.clip_frames.push_back(clips[i].frames);
    plan.splits[clips[i].test ? "test" : "train"].push_back(i);
  }
  plan.made_by = made_by(options.small ? "simpiw-small" : "simpiw", options);
  plan.made_by["power_up"] = "1, 2, 3 in the three rooms";
  std::vector<RoomPlan> rooms;
  std::vector<FastSolver> solvers;
  for (const char* name : kSimPiwRooms) {
    rooms.push_back(read_room_plan(name));
    solvers.emplace_back(rooms.back().still);
  }
  make_dataset(plan, options.threads, [&](std::uint32_t number) {
    const SimPiwClip& it = clips[number];
    Impairments on = options.radio.impairments();
    on.power_up = 1u + it.room;
    const HumanClip clip{{rooms[it.room], it.people, PeopleOptions{}.allowed(), false},
                         number,
                         it.frames,
                         it.room,
                         &solvers[it.room]};
    return make_human_clip(clip, options.format(), on, options.seed, options.rate_hz);
  });
}

void add_folder_options(CLI::App& command, DatasetOptions& options) {
  command.add_option("--out", options.folder, "folder; an interrupted run goes on where it stopped")
      ->required();
  command.add_option("--threads", options.threads, "same bytes for any number")
      ->check(CLI::Range(1u, 1024u))
      ->capture_default_str();
  command
      .add_option("--store", options.store,
                  "int8: what the card reports; complex64, float16: the channel before any radio")
      ->check(CLI::IsMember({"int8", "complex64", "float16"}))
      ->capture_default_str();
}
void add_common_options(CLI::App& command, DatasetOptions& options) {
  add_folder_options(command, options);
  command.add_option("--clips", options.clips, "scenes")
      ->check(CLI::Range(1u, 10'000'000u))
      ->capture_default_str();
  command.add_option("--frames", options.frames, "per clip")
      ->check(CLI::Range(1u, 100'000u))
      ->capture_default_str();
  command
      .add_option(
          "--snapshots", options.snapshots,
          "of a frame; fewer than 20: to learn from with as few samples, see docs/simulator-dataset.md")
      ->check(CLI::Range(std::size_t{1}, std::size_t{kSamples}))
      ->capture_default_str();
  command.add_option("--rate", options.rate_hz, "snapshots a second")
      ->check(CLI::Range(1.0, 10'000.0))
      ->capture_default_str();
  command.add_option("--seed", options.seed, "same seed, same bytes")->capture_default_str();
  add_radio_options(command, options.radio);
  add_ways_options(command, options.ways);
}

void add_object(CLI::App& dataset) {
  auto options = std::make_shared<DatasetOptions>();
  CLI::App* command =
      dataset.add_subcommand("object", "random rooms with one to four flying solids, without labels");
  add_common_options(*command, *options);
  command->callback([options] { make_object_dataset(*options); });
}

void add_human(CLI::App& dataset) {
  auto options = std::make_shared<HumanOptions>();
  CLI::App* command = dataset.add_subcommand("human", "people in rooms, with their joints");
  add_common_options(*command, *options);
  command
      ->add_option("--room", options->room,
                   "random: another for each clip; office, classroom, corridor, empty, or a room's file")
      ->capture_default_str();
  command->add_option("--least-people", options->least_people)
      ->check(CLI::Range(1, 3))
      ->capture_default_str();
  command->add_option("--most-people", options->most_people)->check(CLI::Range(1, 3))->capture_default_str();
  add_people_options(*command, options->who);
  command->callback([options] { make_human_dataset(*options); });
}

void add_benchmark_sets(CLI::App& dataset) {
  auto simpiw = std::make_shared<SimPiwOptions>();
  CLI::App* command = dataset.add_subcommand(
      "simpiw", "the benchmark: three rooms, one to three people, train and test of the published sizes");
  add_folder_options(*command, *simpiw);
  command->add_flag("--small", simpiw->small, "a tenth of it");
  command->callback([simpiw] { make_simpiw(*simpiw); });
  auto object = std::make_shared<DatasetOptions>();
  object->ways.clutter = true;
  command = dataset.add_subcommand(
      "object-90k", "the pre-training set: 900 clips of 100 frames, seed 1, walls that scatter");
  add_folder_options(*command, *object);
  command->callback([object] { make_object_dataset(*object); });
}

}  // namespace

void add_dataset(CLI::App& app) {
  CLI::App* dataset = app.add_subcommand(
      "dataset", "write a data set: NumPy arrays and dataset.json (docs/simulator-dataset.md)");
  dataset->require_subcommand(1);
  add_object(*dataset);
  add_human(*dataset);
  add_benchmark_sets(*dataset);
}

}  // namespace csipose::sim
