// capture/agent/outlet.h - where an agent's packets go: sealed datagrams, or csitool's TCP for testing.
#pragma once

#include <cstdint>
#include <memory>
#include <string>

#include "proto/bytes.h"
#include "proto/datagram.h"
#include "proto/time.h"

namespace csipose {

class Outlet {
 public:
  virtual ~Outlet() = default;
  virtual int descriptor() const = 0;
  /// Whether somebody listens: a file begins to play only then.
  virtual bool ready(SteadyTime now) const = 0;
  /// Sends one packet's records (at most one framed 0xC1 and one 0xBB). Never waits for the network.
  virtual void send(ByteView records, SteadyTime now) = 0;
  /// What has to be done besides: answers, HELLO, keep-alive. Call at least ten times a second.
  virtual void tend(SteadyTime now) = 0;
  /// Records that this host lost before they came here, since the start.
  virtual void lost_in_host(std::uint64_t records) = 0;
  /// For the status line.
  virtual std::string status(SteadyTime now) const = 0;
};

/// Throw SetupError when the address cannot be used.
std::unique_ptr<Outlet> open_sealed_outlet(const AgentKey& key, const std::string& host_and_port);
std::unique_ptr<Outlet> open_csitool_outlet(const std::string& host_and_port);

}  // namespace csipose
