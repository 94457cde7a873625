// csipose-train dataset: data sets to the form that training reads, what they look like, and parts of them.
#include <fmt/core.h>

#include <CLI/CLI.hpp>
#include <cstdio>
#include <memory>

#include "train/commands.h"
#include "train/convert.h"
#include "train/profile.h"
#include "train/split.h"

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

void run_split(const SplitJob& job) {
  Warnings warnings;
  for (const SplitPart& part : split(job, warnings.printer()))
    fmt::print("{}: {} windows\n", (job.to / part.name).string(), part.windows);
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
  command
      ->add_option("--installation", job->installation,
                   "all of it was received in this installation (a room, its receivers, their last powering "
                   "up), which gives it a "
                   "background of its own")
      ->type_name("NAME");
  command->callback([job] { run_convert(*job); });
}

void add_profile(CLI::App& dataset) {
  auto job = std::make_shared<ConvertJob>();
  CLI::App* command = dataset.add_subcommand(
      "profile", "windows by scene and people, amplitudes, bones, axes; of a folder of windows too");
  add_source_options(*command, *job);
  command->callback([job] { run_profile(*job); });
}

void add_split(CLI::App& dataset) {
  auto job = std::make_shared<SplitJob>();
  CLI::App* command = dataset.add_subcommand("split", "a set to several folders of windows");
  command->add_option("--from", job->from, "folder of windows; with --by lists a published or simulated set")
      ->required();
  command->add_option("--out", job->to, "folder in which each part gets its own")->required();
  auto by = std::make_shared<std::string>();
  command
      ->add_option("--by", *by,
                   "lists: its own splits; environment: each by itself; clip: whole clips; window: windows "
                   "of every clip; time: the last windows of every clip")
      ->required()
      ->check(CLI::IsMember({"lists", "environment", "clip", "window", "time"}));
  command->add_option("--share", job->share, "of clips or windows that are drawn")
      ->check(CLI::Range(0.0, 1.0))
      ->capture_default_str();
  command->add_option("--seed", job->seed, "which are drawn; not by time")->capture_default_str();
  add_published_options(*command, job->options);
  command->callback([job, by] {
    const std::map<std::string, SplitBy> ways = {{"lists", SplitBy::lists},
                                                 {"environment", SplitBy::environment},
                                                 {"clip", SplitBy::clip},
                                                 {"window", SplitBy::window},
                                                 {"time", SplitBy::time}};
    job->by = ways.at(*by);
    run_split(*job);
  });
}

}  // namespace

void add_dataset(CLI::App& app) {
  CLI::App* dataset =
      app.add_subcommand("dataset", "data sets to the form that training reads; what they look like");
  dataset->require_subcommand(1);
  add_convert(*dataset);
  add_profile(*dataset);
  add_split(*dataset);
}

}  // namespace csipose::train
