#include "sim/packet_feed.h"

#include <cassert>

namespace csipose::sim {

PacketFeed::PacketFeed(std::unique_ptr<MovingScene> scene, const Impairments& radio, std::uint64_t seed,
                       std::uint32_t clip, double rate_hz)
    : channels_(solve_as_it_moves(std::move(scene))),
      bank_(radio, Band{}, seed, clip, rate_hz),
      rate_hz_(rate_hz) {}

void PacketFeed::next(SentPacket& out) {
  const Instant& now = channels_->next();
  out.grid_s = bank_.packets_sent() / rate_hz_;
  for (auto& records : out.records) records.clear();
  out.sent_s = bank_.send(now.channel, out.records);
  out.counter = bank_.packets_sent();
  out.people = now.people;
}

ReadAhead::ReadAhead(PacketFeed feed, std::size_t depth)
    : feed_(std::move(feed)), slots_(depth), thread_([this] { work(); }) {
  assert(depth >= 2 * kSamples);
}

ReadAhead::~ReadAhead() {
  {
    const std::lock_guard lock(mutex_);
    stop_ = true;
  }
  room_.notify_one();
  thread_.join();
}

const SentPacket* ReadAhead::front() {
  const std::lock_guard lock(mutex_);
  if (made_ != taken_) return &slots_[taken_ % slots_.size()];
  if (failure_) std::rethrow_exception(failure_);
  return nullptr;
}

void ReadAhead::pop() {
  std::size_t free = 0;
  {
    const std::lock_guard lock(mutex_);
    assert(made_ != taken_);
    ++taken_;
    free = slots_.size() - (made_ - taken_);
  }
  if (free == kSamples) room_.notify_one();  // physics comes in batches: it is not woken for each packet
}

std::size_t ReadAhead::ready() {
  const std::lock_guard lock(mutex_);
  return made_ - taken_;
}

bool ReadAhead::wait_for_room() {
  std::unique_lock lock(mutex_);
  const auto full = [&] { return made_ - taken_ == slots_.size(); };
  // Once full, it sleeps until a whole batch has room.
  if (full()) room_.wait(lock, [&] { return stop_ || made_ - taken_ + kSamples <= slots_.size(); });
  return !stop_;
}

void ReadAhead::work() {
  try {
    while (wait_for_room()) {
      feed_.next(slots_[made_ % slots_.size()]);  // made_ is written by this thread alone
      const std::lock_guard lock(mutex_);
      ++made_;
    }
  } catch (...) {
    const std::lock_guard lock(mutex_);
    failure_ = std::current_exception();
  }
}

}  // namespace csipose::sim
