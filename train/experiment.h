// train/experiment.h - the rows of the published tables as named experiments: what differs, what was published.
//
// source: the tables of the WiFi-JEPA paper. All rows are fine-tuned and judged alike; what differs is the pre-training
// before, or that there is none.
#pragma once

#include <cstdint>
#include <filesystem>
#include <string>
#include <string_view>
#include <vector>

#include "train/run_file.h"

namespace csipose::train {

/// Data by role: an experiment says which it needs. Where environments are left out, each folder of `real` is one, and
/// `test` has one for each in the same order.
struct ExperimentData {
  std::vector<std::string> real, objects, humans, test;
};

/// What a row is pre-trained on without labels: nothing, or these sets.
struct PretrainingData {
  bool real = false, objects = false, humans = false;
  double share = 1;  ///< of each

  bool any() const { return real || objects || humans; }
};

struct Experiment {
  std::string_view id;     ///< "T5f"
  std::string_view words;  ///< "real and sim-object"
  double published_mm;     ///< MPJPE of the whole test set; 0: not published as one number
  PretrainingData pretraining;
  std::string_view mask = "link";  ///< of pre-training
  bool flat_tokens = false;        ///< patches of the flattened window for tokens
  bool leave_one_out = false;      ///< each environment in turn is kept from learning, and judged on
};
/// Every row that can be run, in the order of the tables.
const std::vector<Experiment>& experiments();
/// Throws SetupError (usage) that lists the names.
const Experiment& experiment_named(std::string_view id);

struct ExperimentResult {
  std::uint64_t seed = 0;
  double error_mm = 0;  ///< piw3d on the test windows
  /// Where each environment was left out: that on each, in the order of the data; error_mm is their mean.
  std::vector<double> environments_mm{};
};
/// Runs a row for each seed in folders below `settings.run.out`; finished parts are not done again. `settings` gives
/// preset, epochs and everything else that rows share. Throws SetupError (bad_config) when data is missing.
std::vector<ExperimentResult> run_experiment(const Experiment& experiment, const RunSettings& settings,
                                             const ExperimentData& data,
                                             const std::vector<std::uint64_t>& seeds);

}  // namespace csipose::train
