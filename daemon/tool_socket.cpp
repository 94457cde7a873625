#include "daemon/tool_socket.h"

#include <filesystem>

#include "daemon/tool.h"

namespace csipose {
namespace {

/// A tool needs to know where the sockets are, not that the daemon's configuration is complete: nothing said
/// at all means the defaults.
Config for_sockets() {
  const ToolOptions& options = tool_options();
  const bool nothing_said =
      options.config.empty() && options.sets.empty() && !std::filesystem::exists(kDefaultConfigFile);
  return nothing_said ? Config{} : tool_config();
}

}  // namespace

Config tool_config() {
  return load_config({tool_options().config, tool_options().sets, process_environment()});
}

std::string pose_socket(const std::string& given) {
  if (!given.empty()) return given;
  const Config config = for_sockets();
  return config.in_run_dir(config.stream.socket);
}

std::string control_socket(const std::string& given) {
  if (!given.empty()) return given;
  const Config config = for_sockets();
  return config.in_run_dir(config.stream.control_socket);
}

}  // namespace csipose
