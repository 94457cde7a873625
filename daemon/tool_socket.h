// daemon/tool_socket.h - where the tool finds the daemon.
#pragma once

#include <string>

#include "daemon/config.h"

namespace csipose {

/// The configuration that the daemon would run with, as far as the command line of this tool names the same.
/// Throws SetupError.
Config tool_config();

/// `given`, or where the configuration puts them. Without any configuration file the defaults' place.
std::string pose_socket(const std::string& given);
std::string control_socket(const std::string& given);

}  // namespace csipose
