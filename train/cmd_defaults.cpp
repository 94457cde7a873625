// csipose-train defaults: a run file with every key, its help and its default.
#include <fmt/core.h>

#include <CLI/CLI.hpp>
#include <memory>

#include "train/commands.h"
#include "train/run_command.h"

namespace csipose::train {

void add_defaults(CLI::App& app) {
  auto options = std::make_shared<RunOptions>();
  CLI::App* command = app.add_subcommand("defaults", "print a run file: every key, what it means and may be");
  command->add_option("--set", options->set, "section.key=value, put in")->allow_extra_args(false);
  command->callback([options] { fmt::print("{}", to_toml(read_run_file({}, options->set), true)); });
}

}  // namespace csipose::train
