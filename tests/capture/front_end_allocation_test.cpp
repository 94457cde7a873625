// Once made, the front end asks for no memory, whatever comes.
#include <gtest/gtest.h>

#include "capture/front_end.h"
#include "tests/capture/made_up_packets.h"
#include "tests/counting_allocator.h"

namespace csipose {
namespace {

std::uint64_t allocations_of_a_run(const FrontEndConfig& config,
                                   const std::vector<testing::StoredPacket>& packets) {
  FrontEnd front_end(config);
  Window window;
  const std::uint64_t before = testing::allocations;
  std::uint64_t windows = 0;
  for (const auto& packet : packets) {
    while (front_end.next() &&
           packet.arrival > front_end.next()->last_sample + std::chrono::milliseconds(15)) {
      front_end.take(window);
      ++windows;
    }
    front_end.add(packet.packet());
  }
  const std::uint64_t made = testing::allocations - before;
  EXPECT_GT(windows, 50U);
  return made;
}

std::vector<testing::MadeUpReceiver> faulty_receivers() {
  std::vector<testing::MadeUpReceiver> receivers(3);
  for (auto& receiver : receivers) {
    receiver.loss = 0.05;
    receiver.jitter_ms = 0.3;
  }
  receivers[1].deaf = [](std::int64_t frame) { return frame > 400 && frame < 700; };
  receivers[2].skew_ppm = 12;
  return receivers;
}

TEST(FrontEndAllocation, TheCounterCounts) {
  const std::uint64_t before = testing::allocations;
  const std::vector<int> some(1000, 1);
  EXPECT_EQ(testing::allocations - before, 1U);
  EXPECT_EQ(some.back(), 1);
}

TEST(FrontEndAllocation, NoneByCounter) {
  testing::MadeUpTransmitter transmitter;
  transmitter.frames = 1200;
  transmitter.pause_s = [](std::int64_t frame) { return frame == 900 ? 0.5 : 0.0; };
  transmitter.frame_record = [](std::int64_t f) {
    return testing::csip_frame(static_cast<std::uint64_t>(f % 1000));
  };
  EXPECT_EQ(allocations_of_a_run({}, make_packets(transmitter, faulty_receivers())), 0U);
}

TEST(FrontEndAllocation, NoneByTime) {
  testing::MadeUpTransmitter transmitter;
  transmitter.frames = 1200;
  transmitter.access_jitter_us = 26;
  transmitter.frame_record = testing::no_frame;
  EXPECT_EQ(allocations_of_a_run({}, make_packets(transmitter, faulty_receivers())), 0U);
}

TEST(FrontEndAllocation, NoneForAFrameOfAnySize) {
  testing::MadeUpTransmitter transmitter;
  transmitter.frames = 1200;
  transmitter.frame_record = [](std::int64_t f) {
    std::vector<std::uint8_t> frame(30 + static_cast<std::size_t>(f) * 53, 0x08);
    return encode_frame_record(ByteView(frame));
  };
  EXPECT_EQ(allocations_of_a_run({}, make_packets(transmitter, faulty_receivers())), 0U);
}

}  // namespace
}  // namespace csipose
