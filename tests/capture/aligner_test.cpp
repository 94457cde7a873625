#include "capture/aligner.h"

#include <gtest/gtest.h>

#include <cmath>
#include <random>

namespace csipose {
namespace {

constexpr double kPeriod_s = 1.0 / 300;
constexpr Nanoseconds kMaxError = std::chrono::milliseconds(20);

/// Frames of one transmitter with irregular gaps, as receivers with known clocks report them.
class Air {
 public:
  explicit Air(double jitter_us) {
    std::mt19937 random(7);
    std::normal_distribution<double> jitter(0, std::max(jitter_us, 1e-9));
    for (int i = 0; i < 3000; ++i) times_us_.push_back(1e6 * kPeriod_s * i + jitter(random));
  }
  /// What receiver r reports of frame i. path_ms: how late its packets arrive.
  Aligner::Frame frame(std::uint8_t r, std::int64_t i, double path_ms = 0.2, std::uint32_t epoch = 0) const {
    constexpr std::array<double, kReceivers> kOffset_us{40e6, 4294e6, 1234e6},
        kSkew{6.4e-6, -11.7e-6, 2.9e-6};
    const double air_us = times_us_[static_cast<std::size_t>(i)];
    const auto nic_us = static_cast<std::int64_t>(std::floor(kOffset_us[r] + air_us * (1 + kSkew[r])));
    const SteadyTime arrival{from_seconds(1000 + air_us * 1e-6 + path_ms * 1e-3)};
    return {r, {nic_us, epoch, true}, arrival, arrival};
  }
  std::vector<Aligner::Frame> frames(std::uint8_t r, std::int64_t from, std::size_t n,
                                     double path_ms = 0.2) const {
    std::vector<Aligner::Frame> out;
    for (std::size_t i = 0; i < n; ++i) out.push_back(frame(r, from + static_cast<std::int64_t>(i), path_ms));
    return out;
  }

 private:
  std::vector<double> times_us_;
};

TEST(Aligner, CountsWhoHeardWhatASecondLater) {
  const Air air(26);
  Aligner aligner(kMaxError);
  for (std::int64_t i = 0; i < 600; ++i) {
    EXPECT_TRUE(aligner.heard(air.frame(0, i), i));
    if (i % 10 == 3) continue;
    EXPECT_TRUE(aligner.heard(air.frame(1, i), i));
    EXPECT_FALSE(aligner.heard(air.frame(1, i), i));  // twice
  }
  EXPECT_LT(aligner.view(0).heard, 310U);
  aligner.finish();
  EXPECT_EQ(aligner.view(0).heard, 600U);
  EXPECT_EQ(aligner.view(0).matched, 540U);
  EXPECT_EQ(aligner.view(0).missed, 0U);
  EXPECT_EQ(aligner.view(1).heard, 540U);
  EXPECT_EQ(aligner.view(1).missed, 60U);
  EXPECT_EQ(aligner.view(2).missed, 600U);
}

TEST(Aligner, TellsClocksOfReceiversWithCounters) {
  const Air air(26);
  Aligner aligner(kMaxError);
  for (std::int64_t i = 0; i < 3000; ++i)
    for (const std::uint8_t r : std::initializer_list<std::uint8_t>{2, 0, 1})
      aligner.heard(air.frame(r, i), i);  // the first heard is the reference
  EXPECT_EQ(aligner.view(2).skew_ppm, 0);
  EXPECT_NEAR(aligner.view(0).skew_ppm, 6.4 - 2.9, 0.1);
  EXPECT_NEAR(aligner.view(1).skew_ppm, -11.7 - 2.9, 0.1);
  EXPECT_NEAR(aligner.view(1).offset_s, 4294 - 1234 - 14.6e-6 * 10, 2e-6);
  EXPECT_LT(aligner.view(1).residual_s, 1.5e-6);
}

TEST(Aligner, TheAxisOutlivesItsReference) {
  const Air air(26);
  Aligner aligner(kMaxError);
  for (std::int64_t i = 0; i < 3000; ++i)
    for (std::uint8_t r = 0; r < kReceivers; ++r)
      if (r != 0 || i < 900) aligner.heard(air.frame(r, i), i);
  EXPECT_NEAR(aligner.view(1).skew_ppm, -18.1, 0.5);
  EXPECT_NEAR(aligner.view(2).skew_ppm, -3.5, 0.5);
  EXPECT_NEAR(aligner.view(2).offset_s, 1234 - 40 - 3.5e-6 * 10, 10e-6);
}

/// Receiver 0 has given the axis with counters; receiver 1 settles on 32 frames and places one hundred more.
void expect_placed_by_time(const Air& air, double path_ms, std::int64_t shift) {
  Aligner aligner(kMaxError);
  for (std::int64_t i = 0; i < 200; ++i) aligner.heard(air.frame(0, i), 5000 + i);
  const auto frames = air.frames(1, 150, Aligner::kSettleFrames, path_ms);
  EXPECT_FALSE(aligner.settled(frames.back()));
  aligner.settle(frames, kPeriod_s);
  for (std::int64_t i = 150; i < 300; ++i) {
    if (i >= 200) aligner.heard(air.frame(0, i), 5000 + i);
    const auto frame = air.frame(1, i, path_ms);
    ASSERT_TRUE(aligner.settled(frame));
    const auto counter = aligner.counter_by_time(frame, kPeriod_s);
    ASSERT_TRUE(counter);
    EXPECT_EQ(*counter, 5000 + i + shift) << i;
    EXPECT_TRUE(aligner.heard(frame, *counter));
  }
}

TEST(Aligner, PlacesByTime) {
  expect_placed_by_time(Air(26), 0.4, 0);
  expect_placed_by_time(Air(0), 0.4, 0);
}

TEST(Aligner, IrregularGapsTellWholePackets) {
  expect_placed_by_time(Air(26), 0.2 + 1e3 * kPeriod_s, 0);
  expect_placed_by_time(Air(26), 0.2 + 5.4e3 * kPeriod_s, 0);
  expect_placed_by_time(Air(26), 0.2 - 3.4e3 * kPeriod_s, 0);
}

TEST(Aligner, WithoutIrregularityTheShortestPathsDecide) {
  expect_placed_by_time(Air(0), 0.2 + 1e3 * kPeriod_s, 1);  // nothing in the data could tell: one packet off
}

TEST(Aligner, NumbersWhatNobodyElseHeardByItsDistanceInTime) {
  const Air air(26);
  Aligner aligner(kMaxError);
  for (std::int64_t i = 0; i < 200; ++i)
    if (i < 100 || i > 110) aligner.heard(air.frame(0, i), i);
  aligner.settle(air.frames(1, 20, Aligner::kSettleFrames), kPeriod_s);
  for (const std::int64_t i : {105, 101, 110, 103, 200, 230})
    EXPECT_EQ(aligner.counter_by_time(air.frame(1, i), kPeriod_s), i) << i;
}

TEST(Aligner, AfterSilenceOrAStepOfItsClockAReceiverSettlesAnew) {
  const Air air(26);
  Aligner aligner(kMaxError);
  for (std::int64_t i = 0; i < 1000; ++i)
    for (const std::uint8_t r : std::initializer_list<std::uint8_t>{0, 1})
      if (r == 0 || i < 300) aligner.heard(air.frame(r, i), i);
  EXPECT_TRUE(aligner.settled(air.frame(1, 400)));
  EXPECT_FALSE(aligner.settled(air.frame(1, 1000)));
  EXPECT_FALSE(aligner.settled(air.frame(1, 400, 0.2, 1)));
  EXPECT_TRUE(aligner.settled(air.frame(0, 1000)));
}

TEST(Aligner, AReceiverThatIsAlwaysAloneLosesItsPlace) {
  const Air air(26);
  Aligner aligner(kMaxError);
  for (std::int64_t i = 0; i < 100; ++i)
    for (const std::uint8_t r : std::initializer_list<std::uint8_t>{0, 1})
      aligner.heard(air.frame(r, i), 2 * i);
  for (std::int64_t i = 100; i < 600; ++i) {
    aligner.heard(air.frame(0, i), 2 * i);
    aligner.heard(air.frame(1, i), 2 * i + 1);  // beside all others
  }
  EXPECT_FALSE(aligner.settled(air.frame(1, 600)));
  EXPECT_TRUE(aligner.settled(air.frame(0, 600)));
}

}  // namespace
}  // namespace csipose
