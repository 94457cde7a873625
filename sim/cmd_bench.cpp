// csipose-sim bench: frames a second through the whole path of a data set, and where the time goes.
#include <fmt/core.h>

#include <CLI/CLI.hpp>
#include <chrono>
#include <filesystem>
#include <memory>
#include <thread>

#include "proto/result.h"
#include "sim/commands.h"
#include "sim/human_clip.h"
#include "sim/object_clip.h"
#include "sim/reference_solver.h"

namespace csipose::sim {
namespace {
namespace fs = std::filesystem;
constexpr double kRate_hz = 300;
constexpr std::uint64_t kSeed = 1;

struct BenchOptions {
  std::uint32_t clips = 4, frames = 40;
  unsigned rounds = 3;
  std::vector<unsigned> threads{1, std::max(1u, std::thread::hardware_concurrency())};
};

/// One kind of frames.
struct Workload {
  const char* name;
  std::function<std::unique_ptr<MovingScene>(std::uint32_t clip)> scene;
  std::vector<ArrayPlan> arrays;
  std::function<ClipRows(std::uint32_t clip, std::uint32_t frames)> rows;
  const FastSolver* solver = nullptr;  ///< where all clips have one room
};

Workload flying_solids() {
  return {
      "sim-object", [](std::uint32_t clip) { return object_scene(kSeed, clip, kRate_hz); }, frame_arrays({}),
      [](std::uint32_t clip, std::uint32_t frames) {
        const auto scene = object_scene(kSeed, clip, kRate_hz);
        return make_clip(*scene, {}, impairments(ImpairmentLevel::intel5300), kSeed, clip, frames, kRate_hz);
      }};
}

Workload three_people() {
  static const HumanSpec spec{read_room_plan("office"), 3, {Action::walk, Action::wave, Action::bend}, false};
  static const FastSolver solver(spec.room.still);
  return {"three people",
          [](std::uint32_t clip) -> std::unique_ptr<MovingScene> {
            return std::make_unique<HumanScene>(spec, kSeed, clip, kRate_hz);
          },
          human_arrays({}),
          [](std::uint32_t clip, std::uint32_t frames) {
            return make_human_clip({spec, clip, frames, 0, &solver}, {},
                                   impairments(ImpairmentLevel::intel5300), kSeed, kRate_hz);
          },
          &solver};
}

template <class Work>
double seconds_of(const Work& work) {
  const auto begin = std::chrono::steady_clock::now();
  work();
  return std::chrono::duration<double>(std::chrono::steady_clock::now() - begin).count();
}

/// The fastest of some rounds: what the machine does when others leave it alone.
template <class Work>
double fastest(unsigned rounds, const Work& work) {
  double best = 1e9;
  for (unsigned i = 0; i < rounds; ++i) best = std::min(best, seconds_of(work));
  return best;
}

class ScratchFolder {
 public:
  ScratchFolder() {
    std::string pattern = (fs::temp_directory_path() / "csipose-sim-bench-XXXXXX").string();
    if (mkdtemp(pattern.data()) == nullptr)
      throw SetupError(ExitStatus::cannot_create, fmt::format("cannot make a folder {}", pattern));
    path_ = pattern;
  }
  ~ScratchFolder() { fs::remove_all(path_); }
  const fs::path& path() const { return path_; }

 private:
  fs::path path_;
};

double whole_path_s(const Workload& work, const BenchOptions& options, unsigned threads) {
  return fastest(options.rounds, [&] {
    ScratchFolder scratch;
    DatasetPlan plan;
    plan.folder = scratch.path() / "set";
    plan.clip_frames.assign(options.clips, options.frames);
    plan.arrays = work.arrays;
    Dataset dataset(plan);
    fill(
        dataset, threads, [&](std::uint32_t clip) { return work.rows(clip, options.frames); },
        [](std::uint32_t, std::uint32_t) {});
    dataset.finish();
  });
}

void run_scenes(const Workload& work, const BenchOptions& options, bool solve) {
  MovingScene::Snapshot snapshot;
  for (std::uint32_t clip = 0; clip < options.clips; ++clip) {
    const auto scene = work.scene(clip);
    if (solve) {
      SceneBatch batch(work.solver ? *work.solver : FastSolver(scene->still()));
      for (std::uint32_t frame = 0; frame < options.frames; ++frame) batch.advance(*scene);
    } else {
      for (std::uint32_t i = 0; i < options.frames * kSamples; ++i) scene->next(snapshot);
    }
  }
}

/// One frame by the reference solver, from one snapshot of it: the others cost the same.
double reference_frame_s(const Workload& work) {
  const auto moving = work.scene(0);
  MovingScene::Snapshot snapshot;
  moving->next(snapshot);
  Scene scene = moving->still();
  scene.snapshots = 1;
  for (const Body& body : snapshot.bodies) scene.bodies.push_back({body, {}});
  return kSamples * seconds_of([&] { solve_reference(scene); });
}

void print(const Workload& work, const BenchOptions& options) {
  const double frames = 1.0 * options.clips * options.frames;
  const double scene_s = fastest(options.rounds, [&] { run_scenes(work, options, false); });
  const double solved_s = fastest(options.rounds, [&] { run_scenes(work, options, true); });
  const double rows_s = fastest(options.rounds, [&] {
    for (std::uint32_t clip = 0; clip < options.clips; ++clip) work.rows(clip, options.frames);
  });
  fmt::print("{}: {} clips of {} frames of {} snapshots, kernels {}\n", work.name, options.clips,
             options.frames, kSamples, best_kernels().name);
  double whole_s = 0;
  for (const unsigned threads : options.threads) {
    whole_s = whole_path_s(work, options, threads);
    fmt::print("  whole path, on disk, {} thread{}  {:8.0f} frames/s\n", threads, threads == 1 ? " " : "s",
               frames / whole_s);
  }
  fmt::print("  one thread, per frame: scene {:.3f} ms, channel {:.3f} ms, radio and rows {:.3f} ms\n",
             1e3 * scene_s / frames, 1e3 * (solved_s - scene_s) / frames, 1e3 * (rows_s - solved_s) / frames);
  const double reference_s = reference_frame_s(work);
  fmt::print("  reference solver, channel alone  {:8.2f} frames/s; the fast one is {:.0f} times as fast\n",
             1 / reference_s, reference_s / ((solved_s - scene_s) / frames));
}

}  // namespace

void add_bench(CLI::App& app) {
  auto options = std::make_shared<BenchOptions>();
  CLI::App* command =
      app.add_subcommand("bench", "frames a second, from scene to disk, and where the time goes");
  command->add_option("--clips", options->clips)->check(CLI::Range(1u, 100'000u))->capture_default_str();
  command->add_option("--frames", options->frames, "of each clip")
      ->check(CLI::Range(1u, 100'000u))
      ->capture_default_str();
  command->add_option("--rounds", options->rounds, "the fastest counts")
      ->check(CLI::Range(1u, 1000u))
      ->capture_default_str();
  command->add_option("--threads", options->threads)
      ->delimiter(',')
      ->check(CLI::Range(1u, 1024u))
      ->capture_default_str();
  command->callback([options] {
    print(flying_solids(), *options);
    print(three_people(), *options);
  });
}

}  // namespace csipose::sim
