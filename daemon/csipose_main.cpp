// csipose - the person's tool: looks at the daemon, at recordings and models; runs the other programs by one
// name.
#include <fmt/format.h>

#include <CLI/CLI.hpp>
#include <array>
#include <cstdio>

#include "daemon/tool.h"
#include "version.h"

namespace csipose {
namespace {

void add_common_options(CLI::App& app) {
  ToolOptions& options = mutable_tool_options();
  app.add_option("--config", options.config, "configuration file; without it /etc/csiposed/csiposed.toml")
      ->type_name("FILE");
  app.add_option("--set", options.sets, "one setting, wins over files; may be repeated")
      ->type_name("SECTION.KEY=VALUE")
      ->allow_extra_args(false);
  app.add_option("--log-level", options.log_level, "error, warn, info or debug")
      ->check(CLI::IsMember({"error", "warn", "info", "debug"}))
      ->type_name("LEVEL");
  app.add_flag("--json", options.json, "answer in JSON");
  app.add_flag("--quiet", options.quiet, "say nothing but the answer");
  app.add_flag("--no-color", options.no_color, "no colours, even on a terminal");
  app.set_version_flag("--version", "csipose " CSIPOSE_VERSION " (commit " CSIPOSE_COMMIT ")");
}

/// Programs that `csipose NAME ...` becomes, options and help included.
constexpr std::array<std::pair<const char*, const char*>, 2> kSiblings = {
    {{"sim", "rooms, people and receivers that are computed (runs csipose-sim)"},
     {"train", "training and evaluation of models (runs csipose-train)"}}};

void become_sibling_if_named(int argc, char** argv) {
  for (const auto& [name, description] : kSiblings)
    if (argc > 1 && std::string(argv[1]) == name)
      become_sibling(std::string("csipose-") + name, std::vector<std::string>(argv + 2, argv + argc));
}

void add_commands(CLI::App& app) {
  add_demo(app);
  add_watch(app);
  add_status(app);
  add_top(app);
  add_replay(app);
  add_record(app);
  add_agent(app);
  add_config(app);
  for (const auto& [name, description] : kSiblings) app.add_subcommand(name, description);
  add_model(app);
  add_infer(app);
  add_inspect(app);
  add_convert(app);
}

std::vector<std::string> command_names(const CLI::App& app) {
  std::vector<std::string> names;
  for (const CLI::App* command : app.get_subcommands({})) names.push_back(command->get_name());
  return names;
}

/// CLI11's words, and what was perhaps meant.
std::string usage_words(const CLI::App& app, const CLI::ParseError& error) {
  const std::vector<std::string> unread = app.remaining(true);
  if (unread.empty() || unread.front().front() == '-')
    return fmt::format("{} See csipose --help.", error.what());
  const std::string meant = nearest_word(unread.front(), command_names(app));
  return fmt::format("'{}' is no command here.{} See csipose --help.", unread.front(),
                     meant.empty() ? "" : " Did you mean '" + meant + "'?");
}

int run(int argc, char** argv) {
  become_sibling_if_named(argc, argv);
  CLI::App app("csipose: people's poses from WiFi channel state, live. Each command has its own --help.");
  app.name("csipose");
  app.require_subcommand(1);
  app.fallthrough();
  add_common_options(app);
  add_commands(app);
  try {
    app.parse(argc, argv);
  } catch (const CLI::ParseError& error) {
    if (error.get_exit_code() == 0) return app.exit(error);  // --help, --version
    throw SetupError(ExitStatus::usage, usage_words(app, error));
  }
  return static_cast<int>(ExitStatus::ok);
}

}  // namespace
}  // namespace csipose

int main(int argc, char** argv) {
  try {
    return csipose::run(argc, argv);
  } catch (const csipose::SetupError& error) {
    fmt::print(stderr, "csipose: {}\n", error.what());
    return static_cast<int>(error.status);
  } catch (const std::exception& error) {
    fmt::print(stderr, "csipose: a bug, please report it with the command that you typed: {}\n",
               error.what());
    return static_cast<int>(csipose::ExitStatus::bug);
  }
}
