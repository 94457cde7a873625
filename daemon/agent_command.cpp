// `csipose agent add|list|remove`: the keys by which receivers are known.
#include <fmt/format.h>
#include <unistd.h>

#include <CLI/CLI.hpp>
#include <algorithm>
#include <array>
#include <cerrno>
#include <cstring>
#include <filesystem>
#include <memory>
#include <nlohmann/json.hpp>

#include "daemon/terminal.h"
#include "daemon/tool.h"
#include "proto/keys.h"

namespace csipose {
namespace {

namespace fs = std::filesystem;

constexpr const char* kKeyFolder = "/etc/csiposed/keys";
constexpr unsigned kAgentPort = 8481;

struct AgentWords {
  std::string id, folder = kKeyFolder, host;
  unsigned port = kAgentPort;
  bool simulated = false, replay = false;
};

std::string key_path(const AgentWords& words) {
  if (words.id.find('/') != std::string::npos)
    throw SetupError(ExitStatus::usage,
                     fmt::format("'{}' is no receiver's id: 1 to 32 of a-z, 0-9, - and _.", words.id));
  return fs::path(words.folder) / (words.id + ".key");
}

std::string host_name() {
  std::array<char, 256> name{};
  return gethostname(name.data(), name.size() - 1) == 0 ? name.data() : "DAEMON_HOST";
}

std::string receiver_table(const AgentWords& words, const std::string& path) {
  return fmt::format("[[receiver]]\nid = \"{}\"\nposition_m = [0.0, 0.0, 1.0]\nkey_file = \"{}\"\n", words.id,
                     path);
}

void make_key_folder(const std::string& folder) {
  std::error_code error;
  if (fs::create_directories(folder, error)) fs::permissions(folder, fs::perms::owner_all, error);
  if (error)
    throw SetupError(
        error == std::errc::permission_denied ? ExitStatus::no_permission : ExitStatus::cannot_create,
        fmt::format("The key folder {} cannot be made: {}. Run as root, or name another with --keys.", folder,
                    error.message()));
}

/// The simulator plays all three receivers, so it is started when all have keys.
std::string simulator_line(const AgentWords& words, const std::string& path, const std::string& host) {
  return fmt::format("csipose-sim live --to {}:{} --keys {},KEY_OF_RX2,KEY_OF_RX3", host, words.port, path);
}

void add(const AgentWords& words) {
  const std::string path = key_path(words), host = words.host.empty() ? host_name() : words.host;
  make_key_folder(words.folder);
  create_agent_key(path, words.id,
                   words.simulated ? KeyKind::simulated
                   : words.replay  ? KeyKind::replay
                                   : KeyKind::live);
  const std::string start_line = words.simulated ? simulator_line(words, path, "127.0.0.1")
                                                 : agent_start_line(path, words.id, host, words.port);
  if (tool_options().json) {
    print_out(nlohmann::json{{"id", words.id}, {"key_file", path}, {"run_on_receiver", start_line}}.dump() +
              '\n');
    return;
  }
  print_out(
      fmt::format("Made {}.\nPut this into csiposed.toml, with the receiver's place in the room, and restart "
                  "csiposed:\n\n{}\n"
                  "Then run this {}:\n\n{}\n",
                  path, receiver_table(words, path),
                  words.simulated ? "here, with the keys of all three receivers in the order of the room's"
                                  : "on the receiver's host",
                  start_line));
}

std::vector<fs::path> key_files(const std::string& folder) {
  std::error_code error;
  std::vector<fs::path> files;
  for (fs::directory_iterator entry(folder, error), end; !error && entry != end; entry.increment(error))
    if (entry->path().extension() == ".key") files.push_back(entry->path());
  if (error && error != std::errc::no_such_file_or_directory)
    throw SetupError(
        ExitStatus::no_permission,
        fmt::format("The key folder {} cannot be read: {}. Run as root.", folder, error.message()));
  std::sort(files.begin(), files.end());
  return files;
}

/// One key as a line, or what is wrong with it.
std::string describe(const fs::path& file) {
  try {
    const AgentKey key = load_agent_key(file);
    if (tool_options().json)
      return nlohmann::json{{"id", key.name}, {"kind", name(key.kind)}, {"key_file", file.string()}}.dump() +
             '\n';
    return fmt::format("{:<16} {:<10} {}\n", key.name, name(key.kind), file.string());
  } catch (const SetupError& error) {
    if (tool_options().json)
      return nlohmann::json{{"key_file", file.string()}, {"error", error.what()}}.dump() + '\n';
    return fmt::format("{:<16} {:<10} {}\n", file.stem().string(), "unusable", error.what());
  }
}

void list(const AgentWords& words) {
  const std::vector<fs::path> files = key_files(words.folder);
  for (const fs::path& file : files) print_out(describe(file));
  if (files.empty() && !tool_options().quiet)
    fmt::print(stderr, "csipose: there are no keys in {}; csipose agent add makes them.\n", words.folder);
}

void remove(const AgentWords& words) {
  const std::string path = key_path(words);
  if (unlink(path.c_str()) != 0)
    throw SetupError(errno == ENOENT ? ExitStatus::no_input : ExitStatus::no_permission,
                     fmt::format("The key {} cannot be removed: {}. csipose agent list shows the keys.", path,
                                 std::strerror(errno)));
  if (!tool_options().quiet)
    print_out(fmt::format(
        "Removed {}. The daemon knows the receiver until it is restarted; take its [[receiver]] table out of "
        "csiposed.toml, and delete the key on the receiver's host.\n",
        path));
}

}  // namespace

void add_agent(CLI::App& app) {
  auto words = std::make_shared<AgentWords>();
  CLI::App* agent = app.add_subcommand("agent", "keys of receivers");
  agent->require_subcommand(1);
  agent->fallthrough();
  agent->add_option("--keys", words->folder, "folder of the key files")
      ->type_name("FOLDER")
      ->capture_default_str();
  CLI::App* adding = agent->add_subcommand(
      "add", "make a receiver's key; prints what to configure and the line to run there");
  adding->add_option("id", words->id, "the receiver's id, such as rx1")->required();
  CLI::Option* sim = adding->add_flag("--sim", words->simulated, "for a simulator: its frames say SIMULATED");
  adding->add_flag("--replay", words->replay, "for an agent that plays a recording: its frames say REPLAY")
      ->excludes(sim);
  adding
      ->add_option("--host", words->host, "this host as the receiver reaches it; without it the host's name")
      ->type_name("HOST");
  adding->add_option("--port", words->port, "port of ingest.listen")
      ->capture_default_str()
      ->check(CLI::Range(1, 65535));
  adding->callback([words] { add(*words); });
  agent->add_subcommand("list", "keys that there are")->callback([words] { list(*words); });
  CLI::App* removing = agent->add_subcommand("remove", "delete a receiver's key here");
  removing->add_option("id", words->id, "the receiver's id")->required();
  removing->callback([words] { remove(*words); });
}

}  // namespace csipose
