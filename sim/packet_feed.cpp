#include "sim/packet_feed.h"

#include <algorithm>
#include <cassert>

namespace csipose::sim {

Point3 point(const Vec3& p) {
  return {static_cast<float>(p.x), static_cast<float>(p.y), static_cast<float>(p.z)};
}

Truth truth_of(const SentPacket& packet, UtcTime sent) {
  Truth truth{packet.counter, packet.grid_s, sent, {}, 0};
  for (const Joints& person : packet.people) {
    truth.people.push_back({static_cast<std::uint32_t>(truth.people.size() + 1), {}});
    std::transform(person.begin(), person.end(), truth.people.back().joints.begin(), point);
  }
  return truth;
}

void send_packet(ChannelSource& channels, ReceiverBank& bank, double rate_hz, SentPacket& out) {
  const Instant& now = channels.next();
  out.grid_s = bank.packets_sent() / rate_hz;
  for (auto& records : out.records) records.clear();
  out.sent_s = bank.send(now.channel, out.records);
  out.counter = bank.packets_sent();
  out.people = now.people;
}

PacketFeed::PacketFeed(std::unique_ptr<MovingScene> scene, const Impairments& radio, std::uint64_t seed,
                       std::uint32_t clip, double rate_hz)
    : channels_(solve_as_it_moves(std::move(scene))),
      bank_(radio, Band{}, seed, clip, rate_hz),
      rate_hz_(rate_hz) {}

void PacketFeed::next(SentPacket& out) { send_packet(*channels_, bank_, rate_hz_, out); }

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
