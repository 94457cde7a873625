// proto/keys.h - the file that holds a receiver's key.
//
// One line of text, mode 0400, the same file on the receiver's host and beside the daemon:
//     csipose-key 1 live rx1 <64 hexadecimal digits>
// The third word is the kind, live, replay or simulated: it decides what the frames say of their source. The fourth
// is the receiver's id in the configuration. Nothing in the file is ever shown, logged or taken from a
// command line. C++17-clean.
#pragma once

#include <cstdint>
#include <string>
#include <vector>

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

/// The numbers (agent_number) of the keys that lie in a folder, those files left out that are no keys or cannot be
/// read.
std::vector<std::uint16_t> agent_numbers_in(const std::string& folder);

/// A random secret whose key has a number that is none of `taken`: numbers have two bytes, and csiposed takes no
/// two keys with the same. Throws SetupError without random numbers, or when all 65,536 are taken.
AgentKey draw_agent_key(const std::string& name, KeyKind kind, const std::vector<std::uint16_t>& taken);

/// Makes a new random key, with another number than those beside it, and writes it to `path`, mode 0400. Throws
/// SetupError when the file exists (a key that is in use is never overwritten) or cannot be made, or `name` is no
/// id: 1 to 32 of a-z, 0-9, '-' and '_'.
void create_agent_key(const std::string& path, const std::string& name, KeyKind kind);

/// The one line to run on the receiver: fetches the key over ssh and starts the agent.
///   daemon_host   name or address of the daemon's host, as the receiver reaches it
std::string agent_start_line(const std::string& key_path, const std::string& name,
                             const std::string& daemon_host, unsigned port);

}  // namespace csipose
