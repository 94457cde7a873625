#include "capture/tx_counter.h"

#include <gtest/gtest.h>

#include <numeric>
#include <random>

#include "proto/frame_record.h"
#include "proto/npy.h"
#include "tests/records.h"
#include "tests/shared_data.h"

namespace csipose {
namespace {

using Bytes = std::vector<std::uint8_t>;

/// The generator as random_packets.c words it: one bit after another.
Bytes slow_stream(std::size_t bytes) {
  std::uint32_t state = 0x1F3D5B79;
  Bytes stream(bytes);
  for (std::uint8_t& byte : stream) {
    for (int step = 0; step < 8; ++step) {
      const std::uint32_t bit = (state >> 31 ^ state >> 29 ^ state >> 25 ^ state >> 24) & 1;
      state = state << 1 | bit;
    }
    byte = static_cast<std::uint8_t>(state);
  }
  return stream;
}

const Bytes& stream() {
  static const Bytes bytes = slow_stream(LfsrBodies::kStreamBytes);
  return bytes;
}

/// Body of a frame, by the definition: a window of the stream that wraps.
Bytes lfsr_body(std::uint64_t frame, std::size_t size) {
  Bytes body(size);
  for (std::size_t i = 0; i < size; ++i) body[i] = stream()[(frame * size + i) % LfsrBodies::kStreamBytes];
  return body;
}

Mpdu data_frame(std::uint16_t sequence_control, ByteView body = {}) {
  static constexpr std::array<std::uint8_t, 6> kAddress = {2, 0, 0, 0, 0, 1};
  Mpdu frame;
  frame.frame_control = 0x0008;
  frame.sequence_control = sequence_control;
  frame.transmitter = kAddress;
  frame.traffic_class = Mpdu::kNoTrafficClass;
  frame.body = body;
  return frame;
}

TEST(LfsrBodies, FillsWhatTheDefinitionFills) {
  for (const std::uint64_t frame : {0ull, 1ull, 19999ull, 20000ull, 123456789ull})
    for (const std::size_t size : {8u, 100u, 101u, 1000u}) {
      Bytes body(size);
      LfsrBodies::fill(frame, body.data(), size);
      EXPECT_EQ(body, lfsr_body(frame, size)) << frame << ' ' << size;
    }
}

TEST(LfsrBodies, FindsEveryPlaceOfTheStream) {
  const LfsrBodies lfsr;
  Bytes wrapped = stream();
  wrapped.insert(wrapped.end(), stream().begin(), stream().begin() + 100);
  for (std::uint32_t position = 0; position < LfsrBodies::kStreamBytes; ++position)
    ASSERT_EQ(lfsr.position(ByteView(wrapped).sub(position, 24)), position);
}

TEST(LfsrBodies, FindsNothingInOtherBodies) {
  const LfsrBodies lfsr;
  std::mt19937 random(1);
  for (int i = 0; i < 20000; ++i) {
    Bytes body(100);
    for (auto& byte : body) byte = static_cast<std::uint8_t>(random());
    EXPECT_FALSE(lfsr.position(body));
  }
  EXPECT_FALSE(lfsr.position(Bytes(100, 0)));
  EXPECT_FALSE(lfsr.position(ByteView(stream()).sub(0, 7)));
  EXPECT_FALSE(lfsr.position({}));
}

/// Of the generator, but from a place outside the 2,000,000 bytes that random_packets sends.
TEST(LfsrBodies, FindsNothingBeyondTheStream) {
  const LfsrBodies lfsr;
  const Bytes longer = slow_stream(LfsrBodies::kStreamBytes + 5000);
  for (std::size_t at = LfsrBodies::kStreamBytes; at + 24 < longer.size(); ++at)
    ASSERT_FALSE(lfsr.position(ByteView(longer).sub(at, 24))) << at;
}

TEST(LfsrBodies, TellsTheFrameForEveryBodySize) {
  for (const std::size_t size : {8u, 24u, 99u, 100u, 101u, 250u, 1024u, 1500u, 4000u, 7936u}) {
    const std::uint32_t period = LfsrBodies::period(size);
    EXPECT_EQ(period, LfsrBodies::kStreamBytes / std::gcd(size, std::size_t{LfsrBodies::kStreamBytes}));
    for (std::uint64_t frame = 0; frame < period; frame += 1 + period / 997) {
      const auto position = static_cast<std::uint32_t>(frame * size % LfsrBodies::kStreamBytes);
      ASSERT_EQ(LfsrBodies::frame_at(position, size), frame) << size;
    }
  }
  EXPECT_FALSE(LfsrBodies::frame_at(50, 100));  // frames of 100 bytes begin at multiples of 100
  EXPECT_FALSE(LfsrBodies::frame_at(0, 0));
}

TEST(CounterRecovery, SettlesOnTheFirstCsipFrame) {
  CounterRecovery counters(CounterMethod::automatic);
  EXPECT_EQ(counters.method(), CounterMethod::automatic);
  const auto record = encode_csip_record({.session = 7, .counter = 1ull << 40, .transmit_ns = 99});
  const auto frame = parse_mpdu(ByteView(record).sub(3));
  ASSERT_TRUE(frame);
  const auto counter = counters.recover(*frame);
  ASSERT_TRUE(counter);
  EXPECT_EQ(counter->value, 1ull << 40);
  EXPECT_EQ(counter->modulus, 0u);
  EXPECT_EQ(counter->session, 7);
  EXPECT_EQ(counter->transmit_ns, 99u);
  EXPECT_EQ(counters.method(), CounterMethod::csip);
  EXPECT_FALSE(counters.recover(data_frame(0)));
  EXPECT_EQ(counters.method(), CounterMethod::csip);
}

TEST(CounterRecovery, SettlesOnTheFirstLfsrBody) {
  CounterRecovery counters(CounterMethod::automatic);
  for (std::uint64_t i = 19990; i < 20010; ++i) {
    const Bytes body = lfsr_body(i, 100);
    const auto counter = counters.recover(data_frame(0, body));
    ASSERT_TRUE(counter);
    EXPECT_EQ(counter->value, i % 20000);
    EXPECT_EQ(counter->modulus, 20000u);
  }
  EXPECT_EQ(counters.method(), CounterMethod::lfsr);
}

TEST(CounterRecovery, SettlesOnSixteenBitsWhenFragmentBitsCount) {
  CounterRecovery counters(CounterMethod::automatic);
  std::uint16_t sequence = 65530;
  for (int i = 0; i < 15; ++i) EXPECT_FALSE(counters.recover(data_frame(sequence++)));
  const auto counter = counters.recover(data_frame(sequence));
  ASSERT_TRUE(counter);
  EXPECT_EQ(counter->value, sequence);
  EXPECT_EQ(counter->modulus, 65536u);
  EXPECT_EQ(counters.method(), CounterMethod::sequence16);
}

TEST(CounterRecovery, SettlesOnTwelveBitsOfAnOrdinaryStack) {
  CounterRecovery counters(CounterMethod::automatic);
  unsigned number = 4090;
  std::optional<TxCounter> counter;
  for (int i = 0; i < 16; ++i, number = (number + 3) % 4096)
    counter = counters.recover(data_frame(static_cast<std::uint16_t>(number << 4)));
  ASSERT_TRUE(counter);
  EXPECT_EQ(counter->value, (4090 + 15 * 3) % 4096u);
  EXPECT_EQ(counter->modulus, 4096u);
  EXPECT_EQ(counters.method(), CounterMethod::sequence12);
}

TEST(CounterRecovery, KeepsOtherTransmittersAndClassesOutOfTwelveBits) {
  CounterRecovery counters(CounterMethod::sequence12);
  EXPECT_TRUE(counters.recover(data_frame(16)));
  Mpdu other = data_frame(32);
  other.traffic_class = 5;
  EXPECT_FALSE(counters.recover(other));
  static constexpr std::array<std::uint8_t, 6> kAnother = {2, 0, 0, 0, 0, 2};
  other = data_frame(48);
  other.transmitter = kAnother;
  EXPECT_FALSE(counters.recover(other));
  Mpdu beacon = data_frame(64);
  beacon.frame_control = 0x0080;
  EXPECT_FALSE(counters.recover(beacon));
  EXPECT_EQ(counters.recover(data_frame(80))->value, 5u);
}

TEST(CounterRecovery, StaysUnsettledWhereNothingCounts) {
  std::mt19937 random(3);
  CounterRecovery constant(CounterMethod::automatic), noise(CounterMethod::automatic);
  for (int i = 0; i < 500; ++i) {
    EXPECT_FALSE(constant.recover(data_frame(0)));
    EXPECT_FALSE(noise.recover(data_frame(static_cast<std::uint16_t>(random()))));
  }
  EXPECT_EQ(constant.method(), CounterMethod::automatic);
  EXPECT_EQ(noise.method(), CounterMethod::automatic);
}

TEST(CounterRecovery, LooksAnewAfterTheTransmitterHasChanged) {
  CounterRecovery counters(CounterMethod::automatic);
  const Bytes body = lfsr_body(5, 100);
  ASSERT_TRUE(counters.recover(data_frame(0, body)));
  std::uint16_t sequence = 100;
  int without = 0;
  while (!counters.recover(data_frame(sequence++))) ASSERT_LT(++without, 100);
  EXPECT_EQ(without, 64 + 15);
  EXPECT_EQ(counters.method(), CounterMethod::sequence16);
}

TEST(CounterRecovery, UsesOnlyTheMethodAskedFor) {
  const Bytes body = lfsr_body(5, 100);
  EXPECT_EQ(CounterRecovery(CounterMethod::sequence16).recover(data_frame(77, body))->value, 77u);
  EXPECT_FALSE(CounterRecovery(CounterMethod::csip).recover(data_frame(77, body)));
  EXPECT_FALSE(CounterRecovery(CounterMethod::none).recover(data_frame(77, body)));
  EXPECT_EQ(CounterRecovery(CounterMethod::lfsr).recover(data_frame(77, body))->value, 5u);
}

/// Three receivers that heard the same frames: each must tell the truth's index.
TEST(CounterRecovery, TellsTheIndexOfEveryFrameOfTheThreeReceivers) {
  CSIPOSE_NEEDS_SHARED_DATA();
  for (const char* receiver : {"rx0", "rx1", "rx2"}) {
    const std::string base = "csi5300/sync/" + std::string(receiver);
    const auto truth = read_npy<std::int32_t>(testing::shared_data(base + "_tx_index.npy"));
    const Bytes bytes = testing::read_bytes(testing::shared_data(base + ".dat"));
    RecordStream records(bytes, RecordStream::Policy::strict);
    CounterRecovery counters(CounterMethod::automatic);
    std::size_t n = 0;
    while (const auto raw = records.next()) {
      if (raw->code != kFrameCode) continue;
      const auto frame = parse_mpdu(raw->body);
      ASSERT_TRUE(frame);
      const auto counter = counters.recover(*frame);
      ASSERT_TRUE(counter);
      ASSERT_EQ(counter->value, truth.data[n++]) << receiver;
    }
    EXPECT_EQ(n, truth.data.size());
  }
}

}  // namespace
}  // namespace csipose
