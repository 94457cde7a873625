// `csipose status` and `csipose top`: how the daemon is doing, once or every second.
#include <fmt/format.h>

#include <CLI/CLI.hpp>
#include <memory>
#include <optional>

#include "daemon/status_view.h"
#include "daemon/stream_client.h"
#include "daemon/terminal.h"
#include "daemon/tool.h"
#include "daemon/tool_socket.h"

namespace csipose {
namespace {

constexpr auto kStatusTimeout =
    std::chrono::seconds(5);  // it comes at once, but for the first second of a daemon

StreamClient subscribe_to_status(const std::string& socket) {
  StreamClient client(pose_socket(socket), tool_options().json ? Format::json : Format::protobuf);
  Subscription asked;
  asked.status = true;
  client.subscribe(asked);
  return client;
}

std::string as_text(const ReceivedStatus& status, bool color) {
  std::string text;
  for (const Line& line : render_status(status)) text += to_text(line, SIZE_MAX, color) + '\n';
  return text;
}

/// What to print for one status, in the form that was asked for.
std::string answer(const StreamClient& client, const ReceivedStatus& status) {
  return tool_options().json ? client.raw() + '\n' : as_text(status, stdout_takes_color());
}

std::optional<ReceivedStatus> next_status(StreamClient& client) {
  ServerMessage message;
  if (client.next(kStatusTimeout, message) != StreamEvent::message) return std::nullopt;
  const auto* status = std::get_if<ReceivedStatus>(&message);
  return status == nullptr ? std::nullopt : std::optional(*status);
}

void show_once(const std::string& socket) {
  StreamClient client = subscribe_to_status(socket);
  const std::optional<ReceivedStatus> status = next_status(client);
  if (!status)
    throw SetupError(ExitStatus::unavailable,
                     "The daemon told no status within 5 s: it is still starting, or stuck.");
  print_out(answer(client, *status));
}

void show_always(const std::string& socket) {
  const StopSignals signals;
  StreamClient client = subscribe_to_status(socket);
  std::unique_ptr<LiveScreen> screen;
  if (stdout_is_terminal() && !tool_options().json) screen = std::make_unique<LiveScreen>();
  while (!StopSignals::stop_wanted()) {
    const std::optional<ReceivedStatus> status = next_status(client);
    if (StopSignals::stop_wanted()) return;
    if (!status) throw SetupError(ExitStatus::unavailable, "The daemon has ended, or said nothing for 5 s.");
    if (screen) screen->draw(render_status(*status), terminal_size());
    if (!screen && !print_out(answer(client, *status) + (tool_options().json ? "" : "\n"))) return;
  }
}

}  // namespace

void add_status(CLI::App& app) {
  auto socket = std::make_shared<std::string>();
  CLI::App* command = app.add_subcommand("status", "how the daemon is doing, once");
  command->add_option("--socket", *socket, "pose socket; without it as configured")->type_name("PATH");
  command->callback([socket] { show_once(*socket); });
}

void add_top(CLI::App& app) {
  auto socket = std::make_shared<std::string>();
  CLI::App* command = app.add_subcommand("top", "how the daemon is doing, every second; Ctrl-C ends it");
  command->add_option("--socket", *socket, "pose socket; without it as configured")->type_name("PATH");
  command->callback([socket] { show_always(*socket); });
}

}  // namespace csipose
