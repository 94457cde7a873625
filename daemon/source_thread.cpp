#include "daemon/source_thread.h"

#include <utility>

#include "proto/time.h"

namespace csipose {
namespace {

constexpr Nanoseconds kPoll = std::chrono::milliseconds(100);  // how soon a stop is seen
constexpr Nanoseconds kPacketNap = std::chrono::microseconds(50);
constexpr Nanoseconds kStatsEvery = std::chrono::milliseconds(500);

}  // namespace

SourceThread::SourceThread(std::unique_ptr<PacketSource> source, PacketRing& ring, bool lossless,
                           std::function<void(const Packet&)> tap)
    : source_(std::move(source)),
      ring_(ring),
      lossless_(lossless),
      tap_(std::move(tap)),
      stats_(source_->stats()) {}

void SourceThread::start() {
  thread_ = std::thread([this] { run(); });
}

void SourceThread::stop() {
  stop_ = true;
  if (thread_.joinable()) thread_.join();
}

void SourceThread::run() {
  try {
    Packet packet;
    SourceEvent event = SourceEvent::nothing;
    while (!stop_.load(std::memory_order_relaxed) && event != SourceEvent::closed) {
      event = source_->poll(kPoll, packet);
      if (event == SourceEvent::packet) pass_on(packet);
      if (steady_now() - stats_at_ >= kStatsEvery) refresh_stats();
    }
  } catch (...) {
    failure_ = std::current_exception();
  }
  refresh_stats();
  ended_.store(true, std::memory_order_release);
}

void SourceThread::pass_on(const Packet& packet) {
  if (tap_) tap_(packet);
  const bool taken = lossless_ ? ring_.push_wait(packet, stop_) : ring_.push(packet);
  if (!taken) ++ring_full_[packet.receiver];
}

SourceStats SourceThread::counted_stats() const {
  SourceStats stats = source_->stats();
  for (std::size_t receiver = 0; receiver < kReceivers; ++receiver)
    if (ring_full_[receiver] > 0)
      stats.refusals.push_back({static_cast<int>(receiver), "ring_full", ring_full_[receiver]});
  return stats;
}

void SourceThread::refresh_stats() {
  SourceStats fresh = counted_stats();
  const std::lock_guard lock(stats_mutex_);
  stats_ = std::move(fresh);
  stats_at_ = steady_now();
}

SourceStats SourceThread::stats() const {
  const std::lock_guard lock(stats_mutex_);
  return stats_;
}

SourceEvent RingInput::poll(Nanoseconds timeout, Packet& packet) {
  if (std::exchange(holding_, false)) ring_.pop();
  const bool may_wait = timeout > Nanoseconds{0};
  const SteadyTime until = may_wait ? steady_now() + timeout : SteadyTime{};
  do {
    const bool ended = source_.ended();  // asked before the ring: what was pushed before the end is seen
    if ((holding_ = ring_.front(packet))) return SourceEvent::packet;
    if (ended) return SourceEvent::closed;
    if (may_wait) std::this_thread::sleep_for(kPacketNap);
  } while (may_wait && steady_now() < until);
  return SourceEvent::nothing;
}

}  // namespace csipose
