// daemon/source_thread.h - the thread that asks the source for packets and fills the loop's ring.
#pragma once

#include <atomic>
#include <exception>
#include <functional>
#include <memory>
#include <mutex>
#include <thread>

#include "capture/packet_ring.h"
#include "capture/source.h"
#include "daemon/loop.h"

namespace csipose {

class SourceThread {
 public:
  /// `tap` sees every packet, on this thread, before the ring does. `lossless`: a full ring is waited for.
  SourceThread(std::unique_ptr<PacketSource> source, PacketRing& ring, bool lossless,
               std::function<void(const Packet&)> tap);
  ~SourceThread() { stop(); }

  void start();
  void stop();
  /// No more packets will come: the recording has ended, or the source broke.
  bool ended() const { return ended_.load(std::memory_order_acquire); }
  /// What broke the source, if something did. After ended().
  std::exception_ptr failure() const { return failure_; }
  /// A copy not older than a second; what found the ring full is among the refusals.
  SourceStats stats() const;
  const PacketSource& source() const { return *source_; }

 private:
  void run();
  void pass_on(const Packet& packet);
  SourceStats counted_stats() const;
  void refresh_stats();

  const std::unique_ptr<PacketSource> source_;
  PacketRing& ring_;
  const bool lossless_;
  const std::function<void(const Packet&)> tap_;
  std::atomic<bool> stop_{false}, ended_{false};
  std::exception_ptr failure_;
  mutable std::mutex stats_mutex_;
  SourceStats stats_;
  SteadyTime stats_at_{};
  std::array<std::uint64_t, kReceivers> ring_full_{};
  std::thread thread_;
};

/// The loop's end of the ring.
class RingInput final : public PacketInput {
 public:
  RingInput(PacketRing& ring, const SourceThread& source) : ring_(ring), source_(source) {}
  SourceEvent poll(Nanoseconds timeout, Packet& packet) override;

 private:
  PacketRing& ring_;
  const SourceThread& source_;
  bool holding_ = false;  ///< the packet given last still lies in the ring
};

}  // namespace csipose
