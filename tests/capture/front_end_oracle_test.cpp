// Random receivers, rates and settings against a slow oracle: maps from slot to frame, windows written down
// from the definition in front_end.h, nothing shared with the code under test but the features of one record.
#include <gtest/gtest.h>

#include <map>
#include <set>

#include "capture/front_end.h"
#include "tests/capture/made_up_packets.h"

namespace csipose {
namespace {

using testing::StoredPacket;

struct Case {
  FrontEndConfig config;
  std::vector<StoredPacket> packets;
};

/// Losses, jitter, dead times, duplicates and packets that overtake each other.
Case random_case(unsigned seed) {
  std::mt19937 random(seed);
  const auto up_to = [&](int n) { return std::uniform_int_distribution<int>(0, n)(random); };
  testing::MadeUpTransmitter transmitter;
  transmitter.hz = std::array{150.0, 300.0, 500.0, 1000.0}[static_cast<std::size_t>(up_to(3))];
  transmitter.frames = static_cast<std::int64_t>(1.5 * transmitter.hz);
  transmitter.access_jitter_us = up_to(60);
  const auto first = static_cast<std::uint64_t>(up_to(1 << 20));
  transmitter.frame_record = [first](std::int64_t f) {
    return testing::csip_frame(first + static_cast<std::uint64_t>(f));
  };
  std::vector<testing::MadeUpReceiver> receivers(3);
  for (auto& receiver : receivers) {
    receiver.offset_us = 1e6 * up_to(4294);
    receiver.skew_ppm = up_to(40) - 20;
    receiver.loss = up_to(2) == 0 ? 0.2 : 0.01;
    receiver.jitter_ms = 0.1 * up_to(5);
    receiver.bfee_count = static_cast<std::uint16_t>(up_to(65535));
    const int dead_from = up_to(static_cast<int>(transmitter.frames)), dead_for = up_to(100);
    receiver.deaf = [=](std::int64_t f) { return f >= dead_from && f < dead_from + dead_for; };
  }
  Case made;
  made.config.tx_hz = transmitter.hz;
  made.config.hop = 1 + up_to(24);
  made.config.max_gap = up_to(5);
  made.packets = make_packets(transmitter, receivers, seed);
  for (int i = 0; i < 20; ++i) {
    const auto at = static_cast<std::size_t>(5 + up_to(static_cast<int>(made.packets.size()) - 20));
    testing::delay_packet(made.packets, at, 4);
    testing::repeat_packet(made.packets, at);
  }
  return made;
}

class Oracle {
 public:
  Oracle(const FrontEndConfig& config, const std::vector<StoredPacket>& packets) : config_(config) {
    const std::int64_t first = packets.front().truth;
    for (const StoredPacket& packet : packets) {
      const double position = static_cast<double>(packet.truth - first) * config.grid_hz / config.tx_hz;
      const auto slot = static_cast<std::int64_t>(std::floor(position));
      auto& frame = slots_[packet.receiver].try_emplace(slot, packet.truth).first->second;
      frame = std::max(frame, packet.truth);
      newest_ = std::max(newest_, slot);
    }
  }
  std::int64_t newest() const { return newest_; }

  void expect_equal(const Window& window) const {
    std::array<float, kChannels * kSamples * kLinks> x{};
    LinkSet links;
    std::uint16_t reasons = 0;
    for (std::uint8_t r = 0; r < kReceivers; ++r) {
      std::array<std::int64_t, kSamples> frames{};
      bool whole = true;
      for (std::size_t t = 0; t < kSamples; ++t) {
        const std::int64_t slot = window.end_slot - 19 + static_cast<std::int64_t>(t);
        const auto [state, frame] = sample(r, slot);
        EXPECT_EQ(window.samples[t][r], state) << "slot " << slot << " receiver " << int(r);
        whole = whole && state != SampleState::missing;
        if (state != SampleState::received) reasons |= kGap;
        frames[t] = frame;
      }
      if (!whole) reasons |= kReceiverMissing;
      for (std::size_t t = 0; whole && t < kSamples; ++t) write(x, r, t, frames[t]);
      for (std::size_t a = 0; whole && a < kAntennas; ++a) links.set(3 * r + a);
    }
    EXPECT_EQ(window.links, links) << window.end_slot;
    EXPECT_EQ(window.reasons, reasons) << window.end_slot;
    EXPECT_TRUE(window.x == x) << window.end_slot;
  }

 private:
  std::pair<SampleState, std::int64_t> sample(std::uint8_t r, std::int64_t slot) const {
    for (int back = 0; back <= config_.max_gap; ++back) {
      const auto found = slots_[r].find(slot - back);
      if (found == slots_[r].end()) continue;
      return {back == 0 ? SampleState::received : SampleState::filled, found->second};
    }
    return {SampleState::missing, -1};
  }
  static void write(std::array<float, kChannels * kSamples * kLinks>& x, std::uint8_t r, std::size_t t,
                    std::int64_t frame) {
    Features features;
    ASSERT_TRUE(extract_features(testing::made_up_csi(r, frame), {}, features));
    for (std::size_t c = 0; c < kChannels; ++c)
      for (std::size_t a = 0; a < kAntennas; ++a) x[(c * 20 + t) * 9 + 3 * r + a] = features[c * 3 + a];
  }

  FrontEndConfig config_;
  std::array<std::map<std::int64_t, std::int64_t>, kReceivers> slots_;  // slot -> newest frame
  std::int64_t newest_ = 0;
};

TEST(FrontEndOracle, RandomReceiversGiveTheWindowsOfTheDefinition) {
  for (unsigned seed = 1; seed <= 40; ++seed) {
    SCOPED_TRACE(seed);
    const Case made = random_case(seed);
    const Oracle oracle(made.config, made.packets);
    FrontEnd front_end(made.config);
    for (const auto& packet : made.packets) front_end.add(packet.packet());
    EXPECT_EQ(front_end.newest_slot(), oracle.newest());
    Window window;
    std::set<std::int64_t> taken;
    while (front_end.next()->end_slot <= front_end.newest_slot()) {
      front_end.take(window);
      taken.insert(window.end_slot);
      oracle.expect_equal(window);
    }
    EXPECT_EQ(taken.size(), static_cast<std::size_t>((oracle.newest() - 19) / made.config.hop + 1));
    if (HasFailure()) return;
  }
}

}  // namespace
}  // namespace csipose
