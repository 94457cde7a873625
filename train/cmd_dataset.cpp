// csipose-train dataset: data sets to the form that training reads.
#include <fmt/core.h>

#include <CLI/CLI.hpp>
#include <memory>

#include "train/commands.h"
#include "train/simulated_windows.h"

namespace csipose::train {
namespace {

void run_convert(const ConvertJob& job) {
  const Converted converted = convert_simulated(job);
  fmt::print("{}: {} windows", job.to.string(), converted.windows);
  if (converted.incomplete > 0)
    fmt::print("; {} rows left out, in which a receiver lost too much", converted.incomplete);
  fmt::print("\n");
}

}  // namespace

void add_dataset(CLI::App& app) {
  CLI::App* dataset = app.add_subcommand("dataset", "data sets to the form that training reads");
  dataset->require_subcommand(1);
  auto job = std::make_shared<ConvertJob>();
  CLI::App* convert = dataset->add_subcommand("convert", "a simulated data set to a folder of windows");
  convert->add_option("--from", job->from, "folder that csipose-sim dataset wrote")->required();
  convert->add_option("--out", job->to, "folder of windows, made when it is not there")->required();
  convert->add_option("--split", job->split, "only the clips of this split: train, val, test");
  convert->callback([job] { run_convert(*job); });
}

}  // namespace csipose::train
