// capture/source.h - where packets come from: kernel netlink, sealed UDP, csitool TCP, a recording or .dat files.
//
// A source never interprets CSI. It gives whole Packets in the order of their arrival and counts what it refused.
#pragma once

#include <memory>
#include <optional>
#include <string>

#include "proto/packet.h"
#include "proto/pose.h"

namespace csipose {

/// What poll() found.
enum class SourceEvent {
  packet,   ///< `packet` was filled; its bytes stay valid until the next call
  nothing,  ///< nothing came before the timeout
  closed,   ///< no more will come (end of a recording); further calls say the same
};

class PacketSource {
 public:
  virtual ~PacketSource() = default;
  /// Waits at most `timeout` for one packet. Never throws for what the outside sends; a broken set-up (socket gone,
  /// unreadable file) throws SetupError. Called from one thread.
  virtual SourceEvent poll(Nanoseconds timeout, Packet& packet) = 0;
  /// LIVE, REPLAY or SIMULATED: follows from the kind of door (and key), never from what a sender says.
  virtual Source kind() const = 0;
  /// For logs: "udp 127.0.0.1:8481", "replay walk.mcap".
  virtual std::string describe() const = 0;
};

}  // namespace csipose
