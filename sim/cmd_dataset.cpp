// csipose-sim dataset object: frames of random rooms with flying solids, for pre-training.
#include <fmt/core.h>
#include <unistd.h>

#include <CLI/CLI.hpp>
#include <chrono>
#include <memory>
#include <thread>

#include "sim/commands.h"
#include "sim/frame_maker.h"
#include "sim/object_clip.h"
#include "version.h"

namespace csipose::sim {
namespace {

struct DatasetOptions {
  std::filesystem::path folder;
  std::uint32_t clips = 900, frames = 100;
  double rate_hz = 300;
  std::uint64_t seed = 1;
  unsigned threads = std::max(1u, std::thread::hardware_concurrency());
  std::string store = "int8", level = "5300";
};

ImpairmentLevel level_of(const std::string& name) {
  return name == "none"   ? ImpairmentLevel::none
         : name == "mild" ? ImpairmentLevel::mild
                          : ImpairmentLevel::intel5300;
}

/// One line on stderr: what is done, how fast, how long still. Rewritten in a terminal, every tenth clip elsewhere.
class Progress {
 public:
  explicit Progress(std::uint32_t frames_per_clip) : frames_per_clip_(frames_per_clip) {}
  void operator()(std::uint32_t done, std::uint32_t clips) {
    ++made_;
    const bool terminal = ::isatty(STDERR_FILENO) != 0;
    if (!terminal && done % 10 != 0 && done != clips) return;
    const double elapsed_s = std::chrono::duration<double>(std::chrono::steady_clock::now() - begin_).count();
    const double clips_per_s = made_ / elapsed_s;
    fmt::print(stderr, "{}clip {} of {}, {:.0f} frames/s, {:.0f} s left{}", terminal ? "\r\x1b[K" : "", done,
               clips, clips_per_s * frames_per_clip_, (clips - done) / clips_per_s,
               terminal && done != clips ? "" : "\n");
  }

 private:
  std::chrono::steady_clock::time_point begin_ = std::chrono::steady_clock::now();
  std::uint32_t frames_per_clip_;
  double made_ = 0;
};

void make_object_dataset(const DatasetOptions& options) {
  const Storage storage = options.store == "int8" ? Storage::records : Storage::channel;
  const ImpairmentLevel level = level_of(options.level);
  DatasetPlan plan{options.folder, options.clips, options.frames, frame_arrays(storage), {}};
  plan.made_by = {{"generator", "sim-object"},
                  {"seed", std::to_string(options.seed)},
                  {"rate_hz", fmt::format("{}", options.rate_hz)},
                  {"impair", storage == Storage::channel ? "none" : options.level},
                  {"store", options.store},
                  {"version", CSIPOSE_VERSION},
                  {"commit", CSIPOSE_COMMIT}};
  Dataset dataset(plan);
  Progress progress(options.frames);
  fill(
      dataset, options.clips, options.threads,
      [&](std::uint32_t clip) {
        const auto scene = object_scene(options.seed, clip, options.rate_hz);
        return make_clip(*scene, storage, level, options.seed, clip, options.frames, options.rate_hz);
      },
      [&](std::uint32_t done, std::uint32_t clips) { progress(done, clips); });
  dataset.finish();
  fmt::print("{}: {} frames in {} clips, seed {}\n", options.folder.string(),
             std::uint64_t{options.clips} * options.frames, options.clips, options.seed);
}

}  // namespace

void add_dataset(CLI::App& app) {
  CLI::App* dataset = app.add_subcommand(
      "dataset", "write a data set: NumPy arrays and dataset.json (docs/simulator-dataset.md)");
  dataset->require_subcommand(1);
  auto options = std::make_shared<DatasetOptions>();
  CLI::App* command =
      dataset->add_subcommand("object", "random rooms with one to four flying solids, without labels");
  command->add_option("--out", options->folder, "folder; an interrupted run goes on where it stopped")
      ->required();
  command->add_option("--clips", options->clips, "rooms")
      ->check(CLI::Range(1u, 10'000'000u))
      ->capture_default_str();
  command->add_option("--frames", options->frames, "of 20 snapshots, per clip")
      ->check(CLI::Range(1u, 100'000u))
      ->capture_default_str();
  command->add_option("--rate", options->rate_hz, "snapshots a second")
      ->check(CLI::Range(1.0, 10'000.0))
      ->capture_default_str();
  command->add_option("--seed", options->seed, "same seed, same bytes")->capture_default_str();
  command->add_option("--threads", options->threads, "same bytes for any number")
      ->check(CLI::Range(1u, 1024u))
      ->capture_default_str();
  command
      ->add_option("--store", options->store,
                   "int8: what the card reports; complex64: the channel before any radio")
      ->check(CLI::IsMember({"int8", "complex64"}))
      ->capture_default_str();
  command->add_option("--impair", options->level, "what the radio spoils, with int8")
      ->check(CLI::IsMember({"none", "mild", "5300"}))
      ->capture_default_str();
  command->callback([options] { make_object_dataset(*options); });
}

}  // namespace csipose::sim
