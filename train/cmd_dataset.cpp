// csipose-train dataset: data sets to the form that training reads, what they look like, and parts of them.
#include <fmt/core.h>

#include <CLI/CLI.hpp>
#include <cstdio>
#include <memory>

#include "train/commands.h"
#include "train/convert.h"
#include "train/profile.h"

namespace csipose::train {
namespace {

/// Prints warnings, the first few of many.
class Warnings {
 public:
  ~Warnings() {
    if (count_ > kShown) std::fprintf(stderr, "csipose-train: and %zu warnings more\n", count_ - kShown);
  }
  Warn printer() {
    return [this](const std::string& words) {
      if (++count_ <= kShown) std::fprintf(stderr, "csipose-train: %s\n", words.c_str());
    };
  }

 private:
  static constexpr std::size_t kShown = 20;
  std::size_t count_ = 0;
};

void print_left_out(std::size_t count, const char* why) {
  if (count > 0) fmt::print("; {} left out, {}", count, why);
}

void run_convert(const ConvertJob& job) {
  Warnings warnings;
  const Converted converted = convert(job, warnings.printer());
  fmt::print("{}: {} windows {} labels, of a {} set", job.to.string(), converted.windows,
             converted.labelled ? "with" : "without", converted.kind);
  print_left_out(converted.left_out.incomplete, "in which a receiver lost too much");
  print_left_out(converted.left_out.unlabelled, "of whose instant there is no truth");
  print_left_out(converted.left_out.broken, "whose files cannot be used");
  fmt::print("\n");
}

void run_profile(const ConvertJob& job) {
  Warnings warnings;
  const auto set = open_data_set(job.from, job.options);
  Profile profile(set->about());
  set->read([&](const LabelledWindow& window) { profile.add(window); }, warnings.printer());
  fmt::print("{}", profile.describe());
}

void add_published_options(CLI::App& command, DataSetOptions& options) {
  command.add_option(
      "--env-map", options.env_map,
      R"(published set: JSON that says which scenes are which environment, {"office": ["1"], ...})");
  command.add_flag("--skip-broken", options.skip_broken,
                   "published set: leave out windows whose files cannot be used, and say which");
}

void add_source_options(CLI::App& command, ConvertJob& job) {
  command
      .add_option("--from", job.from,
                  "published set, simulated set, recording (.mcap, or folder with rx1.dat rx2.dat rx3.dat)")
      ->required();
  command.add_option("--split", job.options.split, "only this split: train, val, test");
  add_published_options(command, job.options);
  command.add_option("--grid-hz", job.options.grid_hz, "recording: samples a second in a window")
      ->check(CLI::Range(1.0, 5000.0))
      ->capture_default_str();
  command.add_option("--hop", job.options.hop, "recording: samples from one window to the next")
      ->check(CLI::Range(1, 1000))
      ->capture_default_str();
}

void add_convert(CLI::App& dataset) {
  auto job = std::make_shared<ConvertJob>();
  CLI::App* command = dataset.add_subcommand("convert", "a data set or a recording to a folder of windows");
  add_source_options(*command, *job);
  command->add_option("--out", job->to, "folder of windows, made when it is not there")->required();
  command->callback([job] { run_convert(*job); });
}

void add_profile(CLI::App& dataset) {
  auto job = std::make_shared<ConvertJob>();
  CLI::App* command = dataset.add_subcommand(
      "profile", "windows by scene and people, amplitudes, bones, axes; of a folder of windows too");
  add_source_options(*command, *job);
  command->callback([job] { run_profile(*job); });
}

}  // namespace

void add_dataset(CLI::App& app) {
  CLI::App* dataset =
      app.add_subcommand("dataset", "data sets to the form that training reads; what they look like");
  dataset->require_subcommand(1);
  add_convert(*dataset);
  add_profile(*dataset);
}

}  // namespace csipose::train
