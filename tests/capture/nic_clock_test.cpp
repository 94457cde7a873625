#include "capture/nic_clock.h"

#include <gtest/gtest.h>

#include <cmath>

#include "tests/capture/moments.h"

namespace csipose {
namespace {

using testing::at;

std::uint32_t low(double us) { return static_cast<std::uint32_t>(static_cast<std::uint64_t>(us)); }

TEST(NicClock, GoesOnThroughAWrap) {
  NicClock clock;
  const double start_us = 4294'967'296.0 - 500'000;
  std::int64_t first = 0;
  for (int i = 0; i < 1000; ++i) {
    const auto reading = clock.read(low(start_us + 1000 * i), true, at(100 + 0.001 * i));
    if (i == 0) first = reading.us;
    EXPECT_EQ(reading.us - first, 1000 * i);
    EXPECT_TRUE(reading.usable);
  }
  EXPECT_EQ(clock.epoch(), 0U);
}

TEST(NicClock, GoesOnThroughASilenceOfSeveralWraps) {
  NicClock clock;
  const std::int64_t first = clock.read(1000, true, at(0)).us;
  EXPECT_EQ(clock.read(low(1000 + 10'000e6), true, at(10'000.2)).us - first, 10'000'000'000);
  EXPECT_EQ(clock.epoch(), 0U);
}

TEST(NicClock, AStepStartsAnEpoch) {
  NicClock clock;
  clock.read(50'000'000, true, at(1));
  clock.read(50'001'000, true, at(1.001));
  EXPECT_EQ(clock.read(45'002'000, true, at(1.002)).epoch, 1U);  // back 5 s, as access points do
  EXPECT_EQ(clock.read(45'003'000, true, at(1.003)).epoch, 1U);
  EXPECT_EQ(clock.read(48'003'000, true, at(1.004)).epoch, 2U);  // ahead 3 s
  EXPECT_EQ(clock.read(47'999'000, true, at(1.005)).epoch, 3U);  // back 5 ms, made after the last
}

TEST(NicClock, AnOvertakenPacketIsNoStep) {
  NicClock clock;
  clock.read(5'000'000, true, at(1));
  clock.read(5'004'000, true, at(1.004));
  const auto late = clock.read(5'001'000, false, at(1.005));
  EXPECT_EQ(late.us, 5'001'000);
  EXPECT_EQ(late.epoch, 0U);
  EXPECT_EQ(clock.read(5'005'000, true, at(1.006)).us, 5'005'000);
}

TEST(NicClock, AConstantIsNoClock) {
  NicClock clock;
  for (int i = 0; i < 8; ++i) clock.read(4, true, at(i));
  EXPECT_FALSE(clock.usable());
  const auto reading = clock.read(4, true, at(9));
  EXPECT_FALSE(reading.usable);
  EXPECT_EQ(clock.on_air(reading, at(9)), at(9));
  EXPECT_EQ(clock.epoch(), 0U);
  EXPECT_EQ(clock.read(1'000'000, true, at(10)).epoch, 1U);  // it runs: everything anew
  EXPECT_TRUE(clock.usable());
}

TEST(NicClock, OnAirIsTheArrivalLessItsDelay) {
  NicClock clock;
  for (int i = 0; i < 3000; ++i) {
    const double true_s = 50 + i / 300.0, delay_s = 0.0002 + 0.001 * (i % 7) + (i % 300 == 150 ? 0.025 : 0);
    const auto reading = clock.read(low(7e6 + i / 300.0 * 1e6 * (1 + 18e-6)), true, at(true_s + delay_s));
    if (i > 20) {
      EXPECT_NEAR(seconds(clock.on_air(reading, at(true_s + delay_s)).time_since_epoch()), true_s + 0.0002,
                  80e-6)
          << i;
    }
  }
}

}  // namespace
}  // namespace csipose
