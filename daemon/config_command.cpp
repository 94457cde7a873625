// `csipose config check|show|default`: what the daemon would run with, and where each value comes from.
#include <CLI/CLI.hpp>
#include <cstdio>

#include "daemon/config.h"
#include "daemon/tool.h"

namespace csipose {
namespace {

Config named_on_command_line() {
  return load_config({tool_options().config, tool_options().sets, process_environment()});
}

void print(const std::string& text) { std::fwrite(text.data(), 1, text.size(), stdout); }

void check() {
  named_on_command_line();
  const std::string& file = tool_options().config;
  if (!tool_options().quiet)
    print((file.empty() ? std::string(kDefaultConfigFile) : file) + ": no mistakes\n");
}

}  // namespace

void add_config(CLI::App& app) {
  CLI::App* config = app.add_subcommand("config", "the daemon's configuration: check, show, default");
  config->require_subcommand(1);
  config->add_subcommand("check", "read everything as the daemon does and say what is wrong")
      ->callback(check);
  config->add_subcommand("show", "what the daemon would run with, and where each value comes from")
      ->callback([] { print(to_toml(named_on_command_line(), false)); });
  config->add_subcommand("default", "every key with its default, meaning and range")->callback([] {
    print(to_toml(Config{}, true));
  });
}

}  // namespace csipose
