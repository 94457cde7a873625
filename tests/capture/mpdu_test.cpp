#include "capture/mpdu.h"

#include <gtest/gtest.h>

#include "capture/tx_counter.h"
#include "proto/crc32.h"
#include "proto/frame_record.h"
#include "proto/npy.h"
#include "tests/records.h"
#include "tests/shared_data.h"

namespace csipose {
namespace {

using Bytes = std::vector<std::uint8_t>;

/// The body of the 0xC1 record of a frame with this control field: `header` bytes counting up, then `body`
/// bytes of 0xB0.
Bytes frame_bytes(std::uint16_t control, std::size_t header, std::size_t body) {
  Bytes frame(header);
  for (std::size_t i = 0; i < header; ++i) frame[i] = static_cast<std::uint8_t>(i);
  store_le(frame.data(), control);
  frame.resize(header + body, 0xB0);
  const Bytes record = encode_frame_record(frame);
  return {record.begin() + 3, record.end()};
}

TEST(Mpdu, ReadsTheHeaderOfADataFrame) {
  const Bytes bytes = frame_bytes(0x0008, 24, 100);
  const auto mpdu = parse_mpdu(bytes);
  ASSERT_TRUE(mpdu);
  EXPECT_EQ(mpdu->frame_control, 0x0008);
  EXPECT_EQ(mpdu->duration, 0x0302);
  EXPECT_EQ(mpdu->sequence_control, 0x1716);
  EXPECT_EQ(mpdu->transmitter.size(), 6u);
  EXPECT_EQ(mpdu->transmitter[0], 10);
  EXPECT_EQ(mpdu->traffic_class, Mpdu::kNoTrafficClass);
  EXPECT_EQ(mpdu->body.size(), 100u);
  EXPECT_EQ(mpdu->body[0], 0xB0);
  EXPECT_TRUE(mpdu->is_data());
}

TEST(Mpdu, FindsTheBodyBehindEveryHeader) {
  struct Case {
    const char* what;
    std::uint16_t control;
    std::size_t header;
    int traffic_class;
  };
  for (const Case& c :
       {Case{"beacon", 0x0080, 24, 16}, Case{"management with HT control", 0x8080, 28, 16},
        Case{"data to the access point", 0x0108, 24, 16}, Case{"four addresses", 0x0308, 30, 16},
        Case{"QoS", 0x0088, 26, 24 & 15}, Case{"QoS, four addresses", 0x0388, 32, 30 & 15},
        Case{"QoS with HT control", 0x8088, 30, 24 & 15}, Case{"data, order bit", 0x8008, 24, 16}}) {
    const Bytes bytes = frame_bytes(c.control, c.header, 7);
    const auto mpdu = parse_mpdu(bytes);
    ASSERT_TRUE(mpdu) << c.what;
    EXPECT_EQ(mpdu->body.size(), 7u) << c.what;
    EXPECT_EQ(mpdu->traffic_class, c.traffic_class) << c.what;
  }
}

TEST(Mpdu, BelievesNothingOfADamagedFrame) {
  const Bytes good = frame_bytes(0x0008, 24, 20);
  for (std::size_t i = 0; i < good.size(); ++i)
    for (int bit = 0; bit < 8; ++bit) {
      Bytes damaged = good;
      damaged[i] = static_cast<std::uint8_t>(damaged[i] ^ (1 << bit));
      const auto mpdu = parse_mpdu(damaged);
      ASSERT_FALSE(mpdu);
      EXPECT_EQ(mpdu.error(), MpduFault::bad_fcs);
    }
}

TEST(Mpdu, IsTooShortWithoutARoomForItsHeader) {
  const Bytes acknowledgement = frame_bytes(0x00D4, 10, 0);
  EXPECT_EQ(parse_mpdu(acknowledgement).error(), MpduFault::too_short);
  EXPECT_EQ(parse_mpdu(ByteView()).error(), MpduFault::too_short);
  const Bytes no_qos_field = frame_bytes(0x0088, 24, 0);
  EXPECT_EQ(parse_mpdu(no_qos_field).error(), MpduFault::too_short);
  EXPECT_TRUE(parse_mpdu(frame_bytes(0x0008, 24, 0)));
}

/// mpdu.npy: offset, length, frame_control, duration, sequence_control, fcs_ok, lfsr_byte_offset, tx_index.
TEST(Mpdu, GivesTheGoldenFieldsAndCounters) {
  CSIPOSE_NEEDS_SHARED_DATA();
  const auto golden =
      read_npy<std::int64_t>(testing::shared_data("csi5300/expected/sample_0x5_64_3000/mpdu.npy"));
  const Bytes bytes = testing::read_bytes(testing::shared_data("csi5300/sample_0x5_64_3000.dat"));
  RecordStream stream(bytes, RecordStream::Policy::strict);
  CounterRecovery counters(CounterMethod::automatic);
  const LfsrBodies lfsr;
  std::size_t n = 0;
  while (const auto raw = stream.next()) {
    if (raw->code != kFrameCode) continue;
    const std::int64_t* row = golden.data.data() + 8 * n++;
    const auto mpdu = parse_mpdu(raw->body);
    ASSERT_TRUE(mpdu);
    const auto counter = counters.recover(*mpdu);
    ASSERT_TRUE(counter);
    EXPECT_EQ(raw->offset, row[0]);
    EXPECT_EQ(raw->body.size() + 1, row[1]);
    EXPECT_EQ(mpdu->frame_control, row[2]);
    EXPECT_EQ(mpdu->duration, row[3]);
    EXPECT_EQ(mpdu->sequence_control, row[4]);
    EXPECT_EQ(1, row[5]);
    EXPECT_EQ(lfsr.position(mpdu->body), row[6]);
    EXPECT_EQ(counter->value, row[7]);
    EXPECT_EQ(counter->modulus, 20000u);
  }
  EXPECT_EQ(n, golden.shape[0]);
  EXPECT_EQ(counters.method(), CounterMethod::lfsr);
}

}  // namespace
}  // namespace csipose
