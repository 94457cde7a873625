#include "capture/packet_ring.h"

#include <gtest/gtest.h>

#include <deque>
#include <random>
#include <vector>

namespace csipose {
namespace {

using Bytes = std::vector<std::uint8_t>;

Packet packet_of(const Bytes& records, std::uint64_t n) {
  return {static_cast<std::uint8_t>(n % 3), SteadyTime(Nanoseconds(n)), UtcTime(Nanoseconds(n + 7)), records};
}
Bytes records_of(std::uint64_t n, std::size_t size) {
  Bytes bytes(size);
  for (std::size_t i = 0; i < size; ++i) bytes[i] = static_cast<std::uint8_t>(n * 31 + i);
  return bytes;
}
void expect_is(const Packet& packet, std::uint64_t n, const Bytes& records) {
  EXPECT_EQ(packet.receiver, n % 3);
  EXPECT_EQ(ns(packet.arrival), static_cast<std::int64_t>(n));
  EXPECT_EQ(ns(packet.arrival_utc), static_cast<std::int64_t>(n + 7));
  EXPECT_EQ(Bytes(packet.records.begin(), packet.records.end()), records);
}

// A queue of whole packets is the oracle; sizes are such that every kind of wrap-around comes.
TEST(PacketRing, IsAQueue) {
  PacketRing ring(4096);
  std::deque<std::pair<std::uint64_t, Bytes>> oracle;
  std::mt19937 random(1);
  std::uint64_t dropped = 0;
  for (std::uint64_t n = 0; n < 20'000; ++n) {
    const Bytes records = records_of(n, random() % 700);
    if (ring.push(packet_of(records, n)))
      oracle.emplace_back(n, records);
    else
      ++dropped;
    for (Packet packet; random() % 2 == 0 && ring.front(packet); ring.pop()) {
      ASSERT_FALSE(oracle.empty());
      expect_is(packet, oracle.front().first, oracle.front().second);
      oracle.pop_front();
    }
  }
  EXPECT_EQ(ring.dropped(), dropped);
  EXPECT_GT(dropped, 100u);
  EXPECT_LT(dropped, 19'000u);
}

TEST(PacketRing, FrontStaysUntilPop) {
  PacketRing ring(1024);
  Packet packet;
  EXPECT_FALSE(ring.front(packet));
  const Bytes records = records_of(1, 10);
  ring.push(packet_of(records, 1));
  EXPECT_TRUE(ring.front(packet));
  EXPECT_TRUE(ring.front(packet));
  expect_is(packet, 1, records);
  ring.pop();
  EXPECT_TRUE(ring.empty());
}

TEST(PacketRing, TooLargeIsDroppedNotWaitedFor) {
  PacketRing ring(1024);
  const std::atomic<bool> stop = false;
  EXPECT_FALSE(ring.push_wait(packet_of(Bytes(600), 1), stop));
  EXPECT_EQ(ring.dropped(), 1u);
}

TEST(PacketRing, AWaitingProducerCanBeStopped) {
  PacketRing ring(1024);
  while (ring.push(packet_of(Bytes(100), 1))) {
  }
  const std::atomic<bool> stop = true;
  EXPECT_FALSE(ring.push_wait(packet_of(Bytes(100), 2), stop));
}

TEST(PacketRing, TwoThreadsLoseNothingWhenTheProducerWaits) {
  constexpr std::uint64_t kPackets = 50'000;
  PacketRing ring(8192);
  const std::atomic<bool> stop = false;
  std::thread producer([&] {
    for (std::uint64_t n = 0; n < kPackets; ++n) ring.push_wait(packet_of(records_of(n, n % 500), n), stop);
  });
  for (std::uint64_t n = 0; n < kPackets;) {
    Packet packet;
    if (!ring.front(packet)) continue;
    expect_is(packet, n, records_of(n, n % 500));
    ring.pop();
    ++n;
  }
  producer.join();
  EXPECT_TRUE(ring.empty());
  EXPECT_EQ(ring.dropped(), 0u);
}

}  // namespace
}  // namespace csipose
