// `csipose record start|stop|list`: recordings that the daemon makes, over its control socket.
#include <fmt/format.h>

#include <CLI/CLI.hpp>
#include <memory>
#include <nlohmann/json.hpp>

#include "daemon/control.h"
#include "daemon/terminal.h"
#include "daemon/tool.h"
#include "daemon/tool_socket.h"

namespace csipose {
namespace {

using Json = nlohmann::json;

std::string sentence(const Json& recording) {
  return fmt::format("{}  {:.1f} MB{}\n", recording.value("file", ""),
                     static_cast<double>(recording.value("bytes", std::uint64_t{0})) / 1e6,
                     recording.value("active", false) ? "  (being written)" : "");
}

/// Asks, and prints the answer as it came or in words.
void ask(const std::string& socket, const std::string& type) {
  const std::string line = ask_daemon(control_socket(socket), type);
  if (tool_options().json) {
    print_out(line + '\n');
    return;
  }
  const Json answer = Json::parse(line);
  if (answer.contains("recordings")) {
    for (const Json& recording : answer["recordings"]) print_out(sentence(recording));
    if (answer["recordings"].empty() && !tool_options().quiet) print_out("There are no recordings.\n");
  } else if (!tool_options().quiet) {
    print_out((type == "record.start" ? "Recording to " : "Recorded ") + sentence(answer));
  }
}

}  // namespace

void add_record(CLI::App& app) {
  auto socket = std::make_shared<std::string>();
  CLI::App* record = app.add_subcommand("record", "recordings that the daemon makes");
  record->require_subcommand(1);
  record->add_option("--socket", *socket, "control socket; without it as configured")->type_name("PATH");
  record->fallthrough();
  for (const auto& [name, description] : {std::pair("start", "begin a recording"),
                                          std::pair("stop", "end it"), std::pair("list", "what there is")})
    record->add_subcommand(name, description)->callback([socket, type = std::string("record.") + name] {
      ask(*socket, type);
    });
}

}  // namespace csipose
