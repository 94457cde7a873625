#include "daemon/own_daemon.h"

#include <fmt/format.h>

#include <filesystem>
#include <optional>
#include <thread>

#include "daemon/tool.h"

namespace csipose {
namespace {

constexpr auto kStartTimeout = std::chrono::seconds(60);  // a large model is prepared and warmed up first
constexpr auto kEndTimeout = std::chrono::seconds(10);

std::vector<std::string> arguments_for(const PrivateFolder& folder,
                                       const std::vector<std::string>& settings) {
  std::vector<std::string> words;
  const ToolOptions& options = tool_options();
  if (!options.config.empty()) words.insert(words.end(), {"--config", options.config});
  for (const std::string& setting : options.sets) words.insert(words.end(), {"--set", setting});
  for (const std::string& setting : settings) words.insert(words.end(), {"--set", setting});
  words.insert(words.end(), {"--set", "daemon.run_dir=" + toml_text(folder.path().string())});
  words.insert(words.end(), {"--set", "stream.socket=\"pose.sock\""});
  return words;
}

}  // namespace

std::string toml_text(const std::string& text) {
  std::string quoted = "\"";
  for (const char c : text) {
    if (c == '"' || c == '\\') quoted += '\\';
    quoted += c;
  }
  return quoted + '"';
}

std::string toml_list(const std::vector<std::string>& texts) {
  std::string list;
  for (const std::string& text : texts) list += (list.empty() ? "" : ", ") + toml_text(text);
  return '[' + list + ']';
}

OwnDaemon::OwnDaemon(const std::vector<std::string>& settings)
    : process_(sibling_program("csiposed"), arguments_for(folder_, settings), folder_ / "csiposed.log") {
  wait_for_socket();
}

void OwnDaemon::wait_for_socket() {
  const auto until = std::chrono::steady_clock::now() + kStartTimeout;
  while (!std::filesystem::exists(socket())) {
    if (const auto status = process_.ended()) fail(*status);
    if (std::chrono::steady_clock::now() > until)
      throw SetupError(
          ExitStatus::unavailable,
          fmt::format("csiposed did not open {} within 60 s. It said:\n{}", socket(), process_.last_words()));
    std::this_thread::sleep_for(std::chrono::milliseconds(10));
  }
}

void OwnDaemon::finish(bool is_ending) {
  if (!is_ending || !process_.wait_for(kEndTimeout)) process_.ask_to_stop();
  const std::optional<int> status = process_.wait_for(kEndTimeout);
  if (!status)
    throw SetupError(ExitStatus::runtime, "csiposed did not end within 10 s of SIGTERM and was killed.");
  if (*status != 0) fail(*status);
}

void OwnDaemon::fail(int status) const {
  throw SetupError(static_cast<ExitStatus>(status),
                   fmt::format("csiposed ended with status {}. It said:\n{}", status, process_.last_words()));
}

}  // namespace csipose
