// capture/agent/options.h - the command line of csipose-agent.
#pragma once

#include <string>
#include <vector>

#include "capture/agent/dat_player.h"

namespace csipose {

struct AgentOptions {
  std::string id, key_file, to;  ///< to: HOST:PORT of the daemon
  std::string
      csitool_tcp;  ///< HOST:PORT: csitool's framing in the clear instead of sealed datagrams; for testing
  std::string dat_file;  ///< empty = this host's NIC
  PlayOptions play;
  bool help = false, version = false;
};

/// Throws SetupError (usage) that says what is wrong with which option.
AgentOptions parse_agent_options(const std::vector<std::string>& arguments);

extern const char* const kAgentHelp;

}  // namespace csipose
