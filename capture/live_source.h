// capture/live_source.h - sources that wait on a file descriptor, alone or several in one thread.
#pragma once

#include <poll.h>

#include <memory>
#include <vector>

#include "capture/source.h"

namespace csipose {

class LiveSource : public PacketSource {
 public:
  /// Readable when take() may have something (poll, epoll). Owned by the source.
  virtual int descriptor() const = 0;
  /// One packet if there is one; never waits. Looks at a bounded number of datagrams, so that a flood of
  /// refused ones starves nobody.
  virtual bool take(Packet& packet) = 0;

  SourceEvent poll(Nanoseconds timeout, Packet& packet) final;
};

/// Several live sources as one: UDP from agents, csitool's TCP and a NIC of this host may feed one daemon.
class LiveSources final : public PacketSource {
 public:
  /// Throws SetupError when some are LIVE and some SIMULATED: a room is one or the other.
  explicit LiveSources(std::vector<std::unique_ptr<LiveSource>> sources);
  SourceEvent poll(Nanoseconds timeout, Packet& packet) override;
  Source kind() const override { return sources_.front()->kind(); }
  std::string describe() const override;
  SourceStats stats() const override;

 private:
  bool take_in_turn(Packet& packet);

  std::vector<std::unique_ptr<LiveSource>> sources_;
  std::vector<pollfd> fds_;
  std::size_t turn_ = 0;
};

/// Now on both clocks, as Packet wants it.
struct Now {
  SteadyTime steady;
  UtcTime utc;
};
Now now_on_both_clocks();

}  // namespace csipose
