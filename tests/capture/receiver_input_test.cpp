#include "capture/receiver_input.h"

#include <gtest/gtest.h>

#include "tests/capture/made_up_packets.h"
#include "tests/capture/moments.h"

namespace csipose {
namespace {

using testing::at;
using testing::csip_frame;

std::vector<std::uint8_t> csi(std::uint16_t bfee_count, std::uint32_t timestamp = 1000,
                              std::uint8_t nrx = 3) {
  CsiRecord record = testing::made_up_csi(0, bfee_count);
  record.bfee_count = bfee_count;
  record.timestamp_low = timestamp;
  record.nrx = nrx;
  std::vector<std::uint8_t> bytes;
  append_bfee_record(record, bytes);
  return bytes;
}
std::vector<std::uint8_t> operator+(std::vector<std::uint8_t> a, const std::vector<std::uint8_t>& b) {
  a.insert(a.end(), b.begin(), b.end());
  return a;
}

class ReceiverInputTest : public ::testing::Test {
 protected:
  /// Counters of the frames that a packet gave; -1 for one without.
  std::vector<std::int64_t> give(const std::vector<std::uint8_t>& bytes) {
    std::vector<std::int64_t> counters;
    input.begin(ByteView(bytes), at(time_s += 0.003));
    ReceivedFrame frame;
    while (input.next(frame))
      counters.push_back(frame.counter ? static_cast<std::int64_t>(frame.counter->value) : -1);
    return counters;
  }
  using Counters = std::vector<std::int64_t>;
  const std::vector<std::uint8_t> noise{0, 5, 0xD0, 1, 2, 3, 4};
  double time_s = 10;
  ReceiverStats stats;
  ReceiverInput input{0, {}, stats};
};

TEST_F(ReceiverInputTest, PairsAFrameWithTheCsiRightBehindIt) {
  EXPECT_EQ(give(csip_frame(7) + csi(1)), (Counters{7}));
  EXPECT_EQ(give(csip_frame(8)), (Counters{}));
  EXPECT_EQ(give(csi(2)), (Counters{8}));
  EXPECT_EQ(stats.unpaired_frames, 0U);
}

TEST_F(ReceiverInputTest, AFrameWithoutCsiIsDropped) {
  EXPECT_EQ(give(csip_frame(7) + csip_frame(8) + csi(1)), (Counters{8}));
  EXPECT_EQ(stats.unpaired_frames, 1U);
  EXPECT_EQ(give(csi(2)), (Counters{-1}));  // the frame is used up
}

TEST_F(ReceiverInputTest, WhateverComesBetweenPartsThem) {
  EXPECT_EQ(give(csip_frame(7) + noise + csi(1)), (Counters{-1}));
  EXPECT_EQ(give(csip_frame(8) + std::vector<std::uint8_t>{0, 3, 0xBB, 1, 2}), (Counters{}));
  EXPECT_EQ(give(csi(2)), (Counters{-1}));
  EXPECT_EQ(give(csip_frame(9) + std::vector<std::uint8_t>{0xFF}), (Counters{}));
  EXPECT_EQ(give(csi(3)), (Counters{-1}));
  EXPECT_EQ(stats.unpaired_frames, 3U);
  EXPECT_EQ(stats.faults[static_cast<std::size_t>(RecordFault::short_record)], 1U);
  EXPECT_EQ(stats.faults[static_cast<std::size_t>(RecordFault::leftover)], 1U);
}

TEST_F(ReceiverInputTest, TwoChainsAreARecordButNotUsable) {
  EXPECT_EQ(give(csip_frame(7) + csi(1, 1000, 2)), (Counters{}));
  EXPECT_EQ(stats.records, 1U);
  EXPECT_EQ(stats.usable, 0U);
}

TEST_F(ReceiverInputTest, CountsWhatDriverAndReaderLost) {
  std::uint32_t timestamp = 0;
  for (const int count : {65'534, 65'535, 0, 1, 4, 5})
    give(csi(static_cast<std::uint16_t>(count), timestamp += 1000));
  EXPECT_EQ(stats.lost_driver, 2U);
  give(csi(3, timestamp));  // only late
  EXPECT_EQ(stats.lost_driver, 1U);
  give(csi(5, timestamp));
  EXPECT_EQ(stats.duplicates, 1U);
  give(csi(60'000, timestamp += 1000));  // the driver was loaded anew
  give(csi(60'001, timestamp += 1000));
  EXPECT_EQ(stats.lost_driver, 1U);
  EXPECT_EQ(stats.clock_epochs, 0U);
}

TEST(RateMeter, CountsTheLastSecondAndForgetsIt) {
  RateMeter meter;
  for (int i = 0; i < 900; ++i) meter.count(at(50 + i / 300.0));
  EXPECT_NEAR(meter.rate_hz(at(53)), 300, 1);
  EXPECT_NEAR(meter.rate_hz(at(53.5)), 150, 1);
  EXPECT_EQ(meter.rate_hz(at(54.2)), 0);
}

}  // namespace
}  // namespace csipose
