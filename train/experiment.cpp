#include "train/experiment.h"

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <algorithm>
#include <numeric>

#include "proto/result.h"
#include "train/finetune.h"
#include "train/pretrain.h"
#include "train/window_folder.h"

namespace csipose::train {
namespace {

namespace fs = std::filesystem;

/// The first windows of another set, whole clips as they come: half of a set for rows that mix halves.
class Part : public WindowSource {
 public:
  Part(std::shared_ptr<const WindowSource> whole, double share)
      : whole_(std::move(whole)),
        size_(static_cast<std::size_t>(share * static_cast<double>(whole_->size()))) {
    while (size_ < whole_->size() && size_ > 0 && whole_->clip(size_) == whole_->clip(size_ - 1)) ++size_;
  }
  std::size_t size() const override { return size_; }
  std::string name() const override { return whole_->name(); }
  void read(std::size_t i, std::span<float> x) const override { whole_->read(i, x); }
  std::span<const Skeleton> people(std::size_t i) const override { return whole_->people(i); }
  std::uint64_t clip(std::size_t i) const override { return whole_->clip(i); }

 private:
  std::shared_ptr<const WindowSource> whole_;
  std::size_t size_;
};

using Sources = std::vector<std::shared_ptr<const WindowSource>>;

void open_into(Sources& sources, const std::vector<std::string>& folders, double share, std::string_view id,
               std::string_view option) {
  if (folders.empty())
    throw SetupError(ExitStatus::bad_config,
                     fmt::format("experiment {} needs data: name it with {}", id, option));
  for (const std::string& folder : folders) {
    auto source = open_window_folder(folder);
    if (share < 1) source = std::make_shared<Part>(source, share);
    sources.push_back(source);
  }
}

Sources pretraining_data(const Experiment& row, const ExperimentData& data) {
  Sources sources;
  const auto& [real, objects, humans, share] = row.pretraining;
  if (real) open_into(sources, data.real, share, row.id, "--data");
  if (objects) open_into(sources, data.objects, share, row.id, "--objects");
  if (humans) open_into(sources, data.humans, share, row.id, "--humans");
  return sources;
}

std::vector<std::uint64_t> all_of(const Pool& pool) {
  std::vector<std::uint64_t> windows(pool.size());
  std::iota(windows.begin(), windows.end(), std::uint64_t{0});
  return windows;
}

double judge(const fs::path& weights_file, Pool& test) {
  const Weights weights = read_weights(weights_file);
  test.give_for(weights.config);
  const bool bf16 = weights.metadata.at("numerics") == "bf16";
  return 1000 * oracle_error_m(weights.parameters, weights.config, test, all_of(test),
                               Numerics{bf16 ? at::kBFloat16 : at::kFloat, 0});
}

/// That of windows from elsewhere for a network that `learnt` is the scaling of: where that knows installations, their backgrounds
/// are measured on windows without labels, as `csipose model background` does in a room.
Normalisation scaling_elsewhere(const Normalisation& learnt, Sources unlabelled) {
  if (learnt.backgrounds.empty()) return learnt;
  Pool pool(std::move(unlabelled));
  pool.measure_scaling(all_of(pool), ScaledBy::background);
  Normalisation scaling = learnt;
  scaling.backgrounds = pool.scaling().front().backgrounds;
  return scaling;
}

void must_finish(const Outcome& outcome) {
  if (!outcome.finished)
    throw SetupError(ExitStatus::try_again, "stopped; the same command goes on where it stopped");
}

/// Error in millimetres on data.test of what is learned from the rest. elsewhere: windows of the environment to be judged in, where
/// nothing was learned in it.
double learn_and_judge(const Experiment& row, const RunSettings& shared, const ExperimentData& data,
                       const fs::path& folder, Sources elsewhere = {}) {
  RunSettings settings = shared;
  settings.pretrain.mask = row.mask;
  settings.network.flat_tokens = row.flat_tokens;
  if (row.pretraining.any()) {
    Pool pool(pretraining_data(row, data));
    settings.run.out = folder / "pretrain";
    must_finish(pretrain(settings, pool, Workers()));
    settings.finetune.init = (folder / "pretrain" / "pretrained.safetensors").string();
  }
  Sources labelled, test;
  open_into(labelled, data.real, 1, row.id, "--data");
  open_into(test, data.test, 1, row.id, "--test");
  Pool pool(std::move(labelled)), judged(std::move(test));
  settings.run.out = folder / "finetune";
  must_finish(finetune(settings, pool, Workers()));
  const Normalisation& learnt = pool.scaling().front();
  judged.set_scaling(elsewhere.empty() ? learnt : scaling_elsewhere(learnt, std::move(elsewhere)));
  return judge(folder / "finetune" / "best.safetensors", judged);
}

/// Error on each environment of what is learned from the others.
std::vector<double> leave_each_out(const Experiment& row, const RunSettings& settings,
                                   const ExperimentData& data, const fs::path& folder) {
  if (data.real.size() < 2 || data.real.size() != data.test.size())
    throw SetupError(
        ExitStatus::bad_config,
        fmt::format("experiment {} needs a folder in --data for each environment, at least two, and in "
                    "--test as many in the same order",
                    row.id));
  std::vector<double> errors_mm;
  for (std::size_t out = 0; out < data.real.size(); ++out) {
    ExperimentData rest = data;
    rest.real.erase(rest.real.begin() + static_cast<std::ptrdiff_t>(out));
    rest.test = {data.test[out]};
    Sources elsewhere;
    open_into(elsewhere, {data.real[out]}, 1, row.id, "--data");
    errors_mm.push_back(
        learn_and_judge(row, settings, rest, folder / fmt::format("without-{}", out), std::move(elsewhere)));
  }
  return errors_mm;
}

ExperimentResult run_seed(const Experiment& row, RunSettings settings, const ExperimentData& data,
                          std::uint64_t seed) {
  const fs::path folder = fs::path(settings.run.out) / fmt::format("{}-seed{}", row.id, seed);
  settings.run.seed = static_cast<int>(seed);
  if (!row.leave_one_out) return {seed, learn_and_judge(row, settings, data, folder)};
  const std::vector<double> each = leave_each_out(row, settings, data, folder);
  return {seed, std::accumulate(each.begin(), each.end(), 0.) / static_cast<double>(each.size()), each};
}

}  // namespace

const std::vector<Experiment>& experiments() {
  static const std::vector<Experiment> rows = {
      {.id = "T2a",
       .words = "each environment left out in turn",
       .published_mm = 324.2,
       .pretraining = {.real = true, .objects = true},
       .leave_one_out = true},
      {.id = "T5a", .words = "from scratch", .published_mm = 102.4, .pretraining = {}},
      {.id = "T5b",
       .words = "pre-trained on sim-object",
       .published_mm = 100.1,
       .pretraining = {.objects = true}},
      {.id = "T5c",
       .words = "pre-trained on sim-human",
       .published_mm = 110.3,
       .pretraining = {.humans = true}},
      {.id = "T5d",
       .words = "pre-trained on the data itself",
       .published_mm = 97.1,
       .pretraining = {.real = true}},
      {.id = "T5e",
       .words = "pre-trained on half of the data and half of sim-object",
       .published_mm = 97.2,
       .pretraining = {.real = true, .objects = true, .share = 0.5}},
      {.id = "T5f",
       .words = "pre-trained on the data and sim-object",
       .published_mm = 93.5,
       .pretraining = {.real = true, .objects = true}},
      {.id = "T7a",
       .words = "random masking",
       .published_mm = 105.14,
       .pretraining = {.real = true},
       .mask = "random"},
      {.id = "T7b",
       .words = "masking of blocks",
       .published_mm = 102.06,
       .pretraining = {.real = true},
       .mask = "block"},
      {.id = "T7c",
       .words = "masking of times",
       .published_mm = 104.24,
       .pretraining = {.real = true},
       .mask = "time"},
      {.id = "T7d", .words = "masking of links", .published_mm = 97.10, .pretraining = {.real = true}},
      {.id = "T8",
       .words = "masking of links, flat 2-D tokens",
       .published_mm = 111.85,
       .pretraining = {.real = true},
       .flat_tokens = true},
  };
  return rows;
}

const Experiment& experiment_named(std::string_view id) {
  const auto& rows = experiments();
  const auto found = std::ranges::find(rows, id, &Experiment::id);
  std::vector<std::string_view> names;
  for (const Experiment& row : rows) names.push_back(row.id);
  if (found == rows.end())
    throw SetupError(ExitStatus::usage,
                     fmt::format("there is no experiment '{}'; take one of {}", id, fmt::join(names, ", ")));
  return *found;
}

std::vector<ExperimentResult> run_experiment(const Experiment& experiment, const RunSettings& settings,
                                             const ExperimentData& data,
                                             const std::vector<std::uint64_t>& seeds) {
  std::vector<ExperimentResult> results;
  for (const std::uint64_t seed : seeds) results.push_back(run_seed(experiment, settings, data, seed));
  return results;
}

}  // namespace csipose::train
