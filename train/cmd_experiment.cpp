// csipose-train experiment: a row of the published tables, ours beside theirs.
#include <fmt/core.h>
#include <fmt/ranges.h>

#include <CLI/CLI.hpp>
#include <cmath>
#include <memory>

#include "model/cpu.h"
#include "proto/result.h"
#include "train/commands.h"
#include "train/experiment.h"
#include "train/loop.h"
#include "train/run_command.h"

namespace csipose::train {
namespace {

struct ExperimentOptions {
  std::vector<std::string> ids;
  std::string preset = "tiny";
  std::vector<std::uint64_t> seeds{0};
  ExperimentData data;
  RunOptions run;
  bool list = false;
};

void print_list() {
  for (const Experiment& row : experiments())
    fmt::print("{}  {:7.2f} mm  {}\n", row.id, row.published_mm, row.words);
}

struct Spread {
  double mean = 0, deviation = 0;  ///< of the sample; 0 for one seed
};
Spread spread_of(const std::vector<ExperimentResult>& results) {
  Spread spread;
  for (const ExperimentResult& result : results) spread.mean += result.error_mm;
  spread.mean /= static_cast<double>(results.size());
  for (const ExperimentResult& result : results)
    spread.deviation += std::pow(result.error_mm - spread.mean, 2);
  if (results.size() > 1)
    spread.deviation = std::sqrt(spread.deviation / static_cast<double>(results.size() - 1));
  return spread;
}

/// One row of the table that the command prints, as documents take it.
void print_row(const Experiment& row, const std::vector<ExperimentResult>& results) {
  std::vector<std::string> each;
  for (const ExperimentResult& result : results) each.push_back(fmt::format("{:.1f}", result.error_mm));
  const Spread ours = spread_of(results);
  fmt::print("| `{}` | {} | {:.2f} | {:.1f} | {:.1f} | {} |\n", row.id, row.words, row.published_mm,
             ours.mean, ours.deviation, fmt::join(each, ", "));
}

/// What the mean of a row with each environment left out is made of.
void print_environments(const Experiment& row, const std::vector<ExperimentResult>& results,
                        const std::vector<std::string>& folders) {
  for (const ExperimentResult& result : results)
    for (std::size_t i = 0; i < result.environments_mm.size(); ++i)
      fmt::print("`{}`, seed {}: {:.1f} mm on {}, learnt from the others\n", row.id, result.seed,
                 result.environments_mm[i], folders[i]);
}

void print_head(const ExperimentOptions& options) {
  fmt::print(
      "learnt from {}; judged on {} by piw3d, the nearest of all hypotheses, mm; preset {}; published: "
      "preset "
      "paper on Person-in-WiFi 3D\n\n| | | published | ours | deviation | seeds {} "
      "|\n|---|---|---|---|---|---|\n",
      fmt::join(options.data.real, ", "), fmt::join(options.data.test, ", "), options.preset,
      fmt::join(options.seeds, ", "));
}

void run_experiment(ExperimentOptions options) {
  if (options.list) return print_list();
  if (options.ids.empty())
    throw SetupError(ExitStatus::usage, "name the experiments, or --list; see docs/training.md");
  options.run.set.push_back("network.preset=" + options.preset);
  RunSettings settings = read_run_file(options.run.file, options.run.set);
  if (settings.run.out.empty()) settings.run.out = "experiments";
  prepare_machine(settings);
  std::vector<std::pair<const Experiment*, std::vector<ExperimentResult>>> done;
  for (const std::string& id : options.ids) {
    const Experiment& row = experiment_named(id);
    done.emplace_back(&row, run_experiment(row, settings, options.data, options.seeds));
  }
  print_head(options);
  for (const auto& [row, results] : done) print_row(*row, results);
  for (const auto& [row, results] : done)
    if (row->leave_one_out) fmt::print("\n"), print_environments(*row, results, options.data.test);
}

}  // namespace

void add_experiment(CLI::App& app) {
  auto options = std::make_shared<ExperimentOptions>();
  CLI::App* command =
      app.add_subcommand("experiment", "rows of the published tables: pre-train, fine-tune, judge");
  command->add_option("rows", options->ids, "T5a, T7d, ...");
  command->add_flag("--list", options->list, "the rows that there are");
  command->add_option("--data", options->data.real, "data sets with labels to learn from");
  command->add_option("--objects", options->data.objects, "sim-object data sets");
  command->add_option("--humans", options->data.humans, "sim-human data sets");
  command->add_option("--test", options->data.test, "data sets to judge by");
  command->add_option("--preset", options->preset, "paper, base, small, tiny, micro")->capture_default_str();
  command->add_option("--seeds", options->seeds, "one run each")->capture_default_str();
  command->add_option("--run", options->run.file, "run file with what the rows share");
  command->add_option("--set", options->run.set, "section.key=value")->allow_extra_args(false);
  command->callback([options] {
    bound_spinning();
    run_experiment(*options);
  });
}

}  // namespace csipose::train
