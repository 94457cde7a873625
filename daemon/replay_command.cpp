// `csipose replay`: runs a daemon of its own on a recording and watches it.
#include <fmt/format.h>

#include <CLI/CLI.hpp>
#include <cmath>
#include <filesystem>
#include <memory>

#include "daemon/own_daemon.h"
#include "daemon/tool.h"
#include "daemon/watch.h"
#include "daemon/watch_options.h"

namespace csipose {
namespace {

struct ReplayWords : WatchWords {
  std::vector<std::string> files;
  std::string speed = "1";
  bool loop = false;
};

/// "max" is what the daemon calls 0.
double speed_of(const std::string& word) {
  if (word == "max") return 0;
  char* end = nullptr;
  const double speed = std::strtod(word.c_str(), &end);
  if (word.empty() || *end != '\0' || !(speed > 0) || !std::isfinite(speed))
    throw SetupError(ExitStatus::usage,
                     fmt::format("--speed {}: give a factor above 0, such as 0.5 or 10, or max.", word));
  return speed;
}

std::vector<std::string> settings_for(const ReplayWords& words) {
  std::vector<std::string> files;
  for (const std::string& file : words.files) {
    if (!std::filesystem::exists(file))
      throw SetupError(
          ExitStatus::no_input,
          fmt::format("{} is not there; name a .mcap recording or one to three .dat files.", file));
    files.push_back(std::filesystem::absolute(file));
  }
  return {"source.kind=\"file\"", "source.files=" + toml_list(files),
          fmt::format("source.speed={:.6f}", speed_of(words.speed)),
          fmt::format("source.loop={}", words.loop), "source.wait_clients=1"};
}

void replay(const ReplayWords& words) {
  WatchOptions options = watch_options(words, "");  // mistakes there are said before anything is started
  OwnDaemon daemon(settings_for(words));
  options.socket = daemon.socket();
  if (words.files.size() == 1) options.truth_recording = words.files.front();
  const WatchOutcome outcome = watch(options);
  daemon.finish(!outcome.bye.empty() || outcome.vanished);
  const std::string sentence = conclude(options, outcome);
  if (!tool_options().quiet) fmt::print(stderr, "csipose: {}\n", sentence);
}

}  // namespace

void add_replay(CLI::App& app) {
  auto words = std::make_shared<ReplayWords>();
  CLI::App* command = app.add_subcommand("replay", "run a recording through the daemon and watch it");
  command->add_option("files", words->files, "a .mcap recording, or one to three csitool .dat files")
      ->required();
  command->add_option("--speed", words->speed, "times as fast as it was recorded, or max")
      ->type_name("X|max");
  command->add_flag("--loop", words->loop, "begin again at the end");
  add_watch_options(*command, *words);
  command->callback([words] { replay(*words); });
}

}  // namespace csipose
