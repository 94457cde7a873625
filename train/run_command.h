// train/run_command.h - what the commands that start a run share: its options, its data, the machine made ready.
#pragma once

#include <filesystem>
#include <string>
#include <vector>

#include "train/batch.h"
#include "train/run_file.h"
#include "train/workers.h"

namespace CLI {
class App;
}

namespace csipose::train {

struct RunOptions {
  std::filesystem::path file;
  std::vector<std::string> set;
};
/// RUN.toml and --set.
void add_run_options(CLI::App& command, RunOptions& options);

/// Settings with a folder and data named. Throws SetupError (bad_config).
RunSettings settings_of(const RunOptions& options);
/// The data sets of data.train, opened.
Pool open_data(const RunSettings& settings);

}  // namespace csipose::train
