// csiposed - people's poses from WiFi channel state, live: the daemon. Runs in the foreground, logs to
// stderr.
#include <fmt/format.h>
#include <signal.h>

#include <CLI/CLI.hpp>
#include <cstdio>

#include "daemon/daemon.h"
#include "daemon/notify.h"
#include "model/cpu.h"
#include "proto/datagram.h"
#include "version.h"

namespace csipose {
namespace {

/// Before any thread: all inherit the mask, and the main thread alone takes signals, one at a time.
void take_signals_in_turn() {
  sigset_t set;
  sigemptyset(&set);
  for (const int signal : {SIGTERM, SIGINT, SIGHUP, SIGUSR1, SIGUSR2}) sigaddset(&set, signal);
  sigprocmask(SIG_BLOCK, &set, nullptr);
  ::signal(SIGPIPE, SIG_IGN);
}

ConfigSources parse_options(CLI::App& app, int argc, char** argv) {
  ConfigSources sources;
  std::string log_level;
  app.add_option("--config", sources.file,
                 "configuration file; without it " + std::string(kDefaultConfigFile))
      ->type_name("FILE");
  app.add_option("--set", sources.set, "one setting, wins over files; may be repeated")
      ->type_name("SECTION.KEY=VALUE")
      ->allow_extra_args(false);
  app.add_option("--log-level", log_level, "error, warn, info or debug")->type_name("LEVEL");
  app.set_version_flag("--version", "csiposed " CSIPOSE_VERSION " (commit " CSIPOSE_COMMIT ")");
  app.parse(argc, argv);
  if (!log_level.empty()) sources.set.push_back("daemon.log_level=" + log_level);
  sources.environment = process_environment();
  return sources;
}

void run(const ConfigSources& sources) {
  bound_spinning();
  const Config config = load_config(sources);
  Log log(STDERR_FILENO, log_level_from(config.daemon.log_level));
  take_signals_in_turn();
  prepare_process_for_inference();
  Daemon(sources, config, inherited_sockets(), log).run();
}

int complain(const char* words, ExitStatus status) {
  fmt::print(stderr, "csiposed: {}\n", words);
  return static_cast<int>(status);
}

}  // namespace
}  // namespace csipose

int main(int argc, char** argv) {
  using namespace csipose;
  CLI::App app("csiposed: people's poses from WiFi channel state, live");
  try {
    run(parse_options(app, argc, argv));
    return 0;
  } catch (const CLI::ParseError& error) {
    return error.get_exit_code() == 0 ? app.exit(error) : complain(error.what(), ExitStatus::usage);
  } catch (const SetupError& error) {
    return complain(error.what(), error.status);
  } catch (const std::exception& error) {
    return complain(error.what(), ExitStatus::runtime);
  }
}
