// proto/sealed_sender.h - one receiver's records out of this host: a UDP socket and the session that seals what it sends.
//
// What csipose-agent and the simulator's three virtual receivers have in common. Never waits for the network; finds a
// daemon that was restarted by itself (datagram.h). C++17-clean.
#pragma once

#include <cstdint>
#include <string>

#include "proto/datagram.h"
#include "proto/file_descriptor.h"

namespace csipose {

struct SocketAddress;

class SealedSender {
 public:
  /// Throws SetupError when the address cannot be used.
  SealedSender(const AgentKey& key, const std::string& host_and_port);

  int descriptor() const { return socket_.get(); }
  /// Whether a daemon listens.
  bool connected(SteadyTime now) const { return session_.connected(now); }
  /// Sends one packet's records (at most one framed 0xC1 and one 0xBB).
  void send(ByteView records, SteadyTime now);
  /// What has to be done besides: answers, HELLO, keep-alive. Call at least ten times a second.
  void tend(SteadyTime now);
  /// Records that this host lost before they came here, since the start.
  void lost_in_host(std::uint64_t records) { lost_in_host_ = static_cast<std::uint32_t>(records); }
  /// For the status line.
  std::string status(SteadyTime now) const;
  const AgentSession::Counts& counts() const { return session_.counts(); }
  /// Datagrams that the system would not take.
  std::uint64_t not_sent() const { return not_sent_; }

 private:
  SealedSender(const AgentKey& key, const SocketAddress& daemon);
  AgentTime time(SteadyTime now);
  void put(ByteView datagram);

  FileDescriptor socket_;
  AgentSession session_;
  std::uint32_t omitted_ = 0, lost_in_host_ = 0, error_us_ = 0;
  std::uint64_t not_sent_ = 0;
  SteadyTime error_known_until_{};
};

/// A connected socket. Throws SetupError.
///   type   as socket(2) takes it
FileDescriptor connect_to(const SocketAddress& address, int type);

/// The part of a packet's records that a datagram can carry: all, or the CSI without its frame, or nothing.
/// Adds what was left out to `omitted`.
ByteView fit_datagram(ByteView records, std::uint32_t& omitted);

}  // namespace csipose
