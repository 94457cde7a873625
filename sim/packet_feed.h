// sim/packet_feed.h - a room in motion as what its three receivers would send: packet after packet, and computed ahead.
//
// The bytes are those that csipose-sim record writes and the numbers those of a data set: same scene, same seed.
#pragma once

#include <array>
#include <condition_variable>
#include <exception>
#include <memory>
#include <mutex>
#include <thread>
#include <vector>

#include "proto/truth.h"
#include "sim/receiver_log.h"
#include "sim/solved_scene.h"

namespace csipose::sim {

/// One packet of the transmitter.
struct SentPacket {
  std::uint64_t counter = 0;  ///< from 1, as in its frame
  double grid_s = 0;          ///< the instant that was computed; `people` stand where they do then
  double sent_s = 0;          ///< when it leaves, a little later on a busy channel
  std::array<std::vector<std::uint8_t>, kReceivers>
      records;  ///< framed 0xC1 and 0xBB; empty where it was missed
  std::vector<Joints> people;
};

/// Sends the next packet through the next instant's channel. `out` may be an old one: its memory is used again.
void send_packet(ChannelSource& channels, ReceiverBank& bank, double rate_hz, SentPacket& out);

Point3 point(const Vec3& p);
/// Where people are, as the truth channel and socket say it.
Truth truth_of(const SentPacket& packet, UtcTime sent);

/// Packets without end.
class PacketFeed {
 public:
  PacketFeed(std::unique_ptr<MovingScene> scene, const Impairments& radio, std::uint64_t seed,
             std::uint32_t clip, double rate_hz);
  /// The next packet. `out` may be an old one: its memory is used again.
  ///   cost   the physics of kSamples instants once in kSamples packets, little for the others
  void next(SentPacket& out);

 private:
  std::unique_ptr<ChannelSource> channels_;
  ReceiverBank bank_;
  double rate_hz_;
};

/// Packets that a thread of its own has made before they are asked for, so that no pace has to wait for physics.
class ReadAhead {
 public:
  /// `depth`: packets that are made at most before they are needed; at least 2 kSamples.
  ReadAhead(PacketFeed feed, std::size_t depth);
  ~ReadAhead();  ///< waits for the packet that is being made
  ReadAhead(const ReadAhead&) = delete;
  ReadAhead& operator=(const ReadAhead&) = delete;

  /// The oldest packet, valid until pop(); nullptr when it is not made yet. Throws what the thread has thrown.
  const SentPacket* front();
  void pop();
  std::size_t ready();

 private:
  void work();
  bool wait_for_room();

  PacketFeed feed_;
  std::vector<SentPacket>
      slots_;  // a ring; slots [taken_, made_) are full and the reader's, the others the thread's
  std::mutex mutex_;
  std::condition_variable room_;
  std::uint64_t made_ = 0, taken_ = 0;
  bool stop_ = false;
  std::exception_ptr failure_;
  std::thread thread_;
};

}  // namespace csipose::sim
