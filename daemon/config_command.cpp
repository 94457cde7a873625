// `csipose config check|show|default`: what the daemon would run with, and where each value comes from.
#include "daemon/config_command.h"

#include <CLI/CLI.hpp>
#include <cstdio>

#include "daemon/config.h"

namespace csipose {
namespace {

/// The options --config and --set of the whole program, wherever they were typed.
ConfigSources named_on_command_line(CLI::App& app) {
  ConfigSources sources;
  sources.environment = process_environment();
  if (const CLI::Option* file = app.get_option_no_throw("--config"); file != nullptr && file->count() > 0)
    sources.file = file->as<std::string>();
  if (const CLI::Option* set = app.get_option_no_throw("--set"); set != nullptr && set->count() > 0)
    sources.set = set->as<std::vector<std::string>>();
  return sources;
}

void print(const std::string& text) { std::fwrite(text.data(), 1, text.size(), stdout); }

void check(CLI::App& app) {
  const ConfigSources sources = named_on_command_line(app);
  load_config(sources);
  print((sources.file.empty() ? std::string(kDefaultConfigFile) : sources.file) + ": no mistakes\n");
}

}  // namespace

void add_config(CLI::App& app) {
  CLI::App* config = app.add_subcommand("config", "the daemon's configuration: check, show, default");
  config->require_subcommand(1);
  config->add_subcommand("check", "read everything as the daemon does and say what is wrong")
      ->callback([&app] { check(app); });
  config->add_subcommand("show", "what the daemon would run with, and where each value comes from")
      ->callback([&app] { print(to_toml(load_config(named_on_command_line(app)), false)); });
  config->add_subcommand("default", "every key with its default, meaning and range")->callback([] {
    print(to_toml(Config{}, true));
  });
}

}  // namespace csipose
