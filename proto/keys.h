// proto/keys.h - the file that holds a receiver's key.
//
// One line of text, mode 0400, the same file on the receiver's host and beside the daemon:
//     csipose-key 1 live rx1 <64 hexadecimal digits>
// The third word is the kind, live, replay or simulated: it decides what the frames say of their source. The fourth
// is the receiver's id in the configuration. Nothing in the file is ever shown, logged or taken from a
// command line. C++17-clean.
#pragma once

#include <string>

#include "proto/datagram.h"
#include "proto/result.h"

namespace csipose {

/// "live", "replay", "simulated".
const char* name(KeyKind kind);

/// Reads the text of a key file; the error says what is wrong with it.
Result<AgentKey, std::string> parse_agent_key(ByteView text);

/// Reads a key file. Throws SetupError when it is missing, holds no key, belongs to somebody else, or others
/// may read it.
AgentKey load_agent_key(const std::string& path);

/// Makes a new random key and writes it to `path`, mode 0400. Throws SetupError when the file exists (a key
/// that is in use is never overwritten) or cannot be made, or `name` is no id: 1 to 32 of a-z, 0-9, '-' and
/// '_'.
void create_agent_key(const std::string& path, const std::string& name, KeyKind kind);

/// The one line to run on the receiver: fetches the key over ssh and starts the agent.
///   daemon_host   name or address of the daemon's host, as the receiver reaches it
std::string agent_start_line(const std::string& key_path, const std::string& name,
                             const std::string& daemon_host, unsigned port);

}  // namespace csipose
