// `csipose watch`: the poses as they come, on a screen or into a pipe.
#include <fmt/format.h>

#include <CLI/CLI.hpp>
#include <cstdio>
#include <memory>

#include "daemon/terminal.h"
#include "daemon/tool.h"
#include "daemon/tool_socket.h"
#include "daemon/watch.h"
#include "daemon/watch_options.h"

namespace csipose {

void add_watch_options(CLI::App& command, WatchWords& words) {
  command
      .add_option("--format", words.format,
                  "live (screen), text (a line per frame), jsonl or proto; without it live on a "
                  "terminal and text elsewhere")
      ->check(CLI::IsMember({"live", "text", "jsonl", "proto"}))
      ->type_name("FORMAT");
  command.add_option("--for", words.duration_s, "end after this many seconds")
      ->check(CLI::PositiveNumber)
      ->type_name("SECONDS");
  command.add_option("--frames", words.frames, "end after this many frames")
      ->check(CLI::PositiveNumber)
      ->type_name("N");
  command.add_option("--max-hz", words.max_hz, "at most this many frames a second")
      ->check(CLI::PositiveNumber)
      ->type_name("HZ");
}

WatchOptions watch_options(const WatchWords& words, const std::string& socket) {
  WatchOptions options;
  options.socket = socket;
  options.truth = words.truth;
  options.frames = words.frames;
  options.max_hz = words.max_hz;
  if (words.duration_s > 0) options.duration = from_seconds(words.duration_s);
  options.format = stdout_is_terminal() ? WatchFormat::live : WatchFormat::text;
  if (tool_options().json || words.format == "jsonl") options.format = WatchFormat::jsonl;
  if (words.format == "live") options.format = WatchFormat::live;
  if (words.format == "text") options.format = WatchFormat::text;
  if (words.format == "proto") options.format = WatchFormat::protobuf;
  if (options.format == WatchFormat::live && !stdout_is_terminal())
    throw SetupError(ExitStatus::usage,
                     "--format live needs a terminal on stdout; use text or jsonl for files and pipes.");
  return options;
}

void watch_and_conclude(const WatchOptions& options) {
  const std::string sentence = conclude(options, watch(options));
  if (!tool_options().quiet) fmt::print(stderr, "csipose: {}\n", sentence);
}

void add_watch(CLI::App& app) {
  struct Words : WatchWords {
    std::string socket;
  };
  auto words = std::make_shared<Words>();
  CLI::App* command = app.add_subcommand("watch", "poses as they come; Ctrl-C ends it");
  command->add_option("--socket", words->socket, "pose socket; without it as configured")->type_name("PATH");
  command
      ->add_option(
          "--truth", words->truth,
          "truth socket of csipose-sim live on this host: draws where people really are, and measures")
      ->type_name("PATH");
  add_watch_options(*command, *words);
  command->callback([words] { watch_and_conclude(watch_options(*words, pose_socket(words->socket))); });
}

}  // namespace csipose
