#include "train/run_command.h"

#include <CLI/CLI.hpp>

#include "proto/result.h"
#include "train/window_folder.h"

namespace csipose::train {

void add_run_options(CLI::App& command, RunOptions& options) {
  command.add_option("run", options.file, "RUN.toml; `csipose-train defaults` prints one");
  command.add_option("--set", options.set, "section.key=value, as often as you like; has the last word")
      ->allow_extra_args(false);
}

RunSettings settings_of(const RunOptions& options) {
  RunSettings settings = read_run_file(options.file, options.set);
  if (settings.run.out.empty())
    throw SetupError(ExitStatus::bad_config, "run.out must name the folder of the run");
  if (settings.data.train.empty())
    throw SetupError(ExitStatus::bad_config, "data.train must name at least one data set");
  return settings;
}

Pool open_data(const RunSettings& settings) {
  std::vector<std::shared_ptr<const WindowSource>> sources;
  for (const std::string& folder : settings.data.train) sources.push_back(open_window_folder(folder));
  return Pool(std::move(sources));
}

}  // namespace csipose::train
