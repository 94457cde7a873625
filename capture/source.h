// capture/source.h - where packets come from: kernel netlink, sealed UDP, csitool TCP, a recording or .dat
// files.
//
// A source never interprets CSI. It gives whole Packets in the order of their arrival and counts what it
// refused.
#pragma once

#include <array>
#include <limits>
#include <string>
#include <vector>

#include "proto/packet.h"
#include "proto/pose.h"

namespace csipose {

/// What poll() found.
enum class SourceEvent {
  packet,   ///< `packet` was filled; its bytes stay valid until the next call
  nothing,  ///< nothing came before the timeout
  closed,   ///< no more will come (end of a recording); further calls say the same
};

/// What a source has counted since its start.
struct SourceStats {
  struct Receiver {
    std::uint64_t packets = 0;  ///< given out
    std::uint64_t lost = 0;     ///< known to have been sent by the agent and never come
    std::uint64_t omitted =
        0;  ///< records that the receiver's host itself lost or left out, as its agent says
    std::uint64_t sessions = 0;  ///< times the receiver has begun to speak: sessions, connections
    double clock_error_s =
        std::numeric_limits<double>::quiet_NaN();  ///< bound on its UTC clock; NaN = not known
  };
  struct Refusal {
    int receiver;        ///< -1: before a receiver could be named
    const char* reason;  ///< from a closed list; lives as long as the program
    std::uint64_t count;
  };
  std::array<Receiver, kReceivers> receivers{};
  std::vector<Refusal> refusals;  ///< those that happened at least once
};

class PacketSource {
 public:
  virtual ~PacketSource() = default;
  /// Waits at most `timeout` for one packet. Never throws for what the outside sends; a broken set-up (socket
  /// gone, unreadable file) throws SetupError. Called from one thread.
  virtual SourceEvent poll(Nanoseconds timeout, Packet& packet) = 0;
  /// LIVE, REPLAY or SIMULATED: follows from the kind of door (and key), never from what a sender says.
  virtual Source kind() const = 0;
  /// For logs: "udp 127.0.0.1:8481", "replay walk.mcap".
  virtual std::string describe() const = 0;
  /// Allocates; called now and then from poll()'s thread, which passes the copy on to whoever reports.
  virtual SourceStats stats() const = 0;
};

}  // namespace csipose
