#include "capture/pair_line.h"

#include <gtest/gtest.h>

#include <cmath>
#include <random>

namespace csipose {
namespace {

/// Whole microseconds of a clock that is fast by `skew`.
std::int64_t nic_us(double axis_us, double skew) { return std::llround(5e9 + axis_us * (1 + skew)); }

TEST(PairLine, FindsOffsetAndSkewToAFractionOfAMicrosecond) {
  PairLine line;
  EXPECT_FALSE(line.anchored());
  line.anchor(nic_us(0, 18e-6), 300);  // 300 us wrong: the pairs say better
  for (int i = 0; i < 3000; ++i) ASSERT_TRUE(line.add(nic_us(i * 1e6 / 300, 18e-6), i * 1e6 / 300));
  EXPECT_NEAR(line.skew(), 18e-6, 0.05e-6);
  EXPECT_NEAR(line.axis_at(nic_us(10e6, 18e-6)), 10e6, 0.6);
  EXPECT_LT(line.residual_us(), 1);
  EXPECT_EQ(line.pairs(), 3000U);
}

TEST(PairLine, FollowsACrystalThatWarmsUp) {
  PairLine line;
  line.anchor(nic_us(0, 0), 0);
  for (int i = 0; i < 30'000; ++i) {
    const double t_us = i * 1e6 / 300, drift = 5e-6 * t_us / 100e6;  // 5 ppm in 100 s
    ASSERT_TRUE(line.add(nic_us(t_us, drift), t_us));
    if (i % 1000 == 999) {
      EXPECT_NEAR(line.axis_at(nic_us(t_us, drift)), t_us, 10) << i;
    }
  }
}

TEST(PairLine, LeavesAFalsePairOut) {
  PairLine line;
  line.anchor(nic_us(0, 0), 0);
  for (int i = 0; i < 600; ++i) {
    const double t_us = i * 1e6 / 300, wrong_us = i % 50 == 49 ? 3333 : 0;
    ASSERT_TRUE(line.add(nic_us(t_us, 0), t_us + wrong_us));
  }
  EXPECT_NEAR(line.axis_at(nic_us(2e6, 0)), 2e6, 0.6);
}

TEST(PairLine, SaysWhenPairsContradictIt) {
  PairLine line;
  line.anchor(nic_us(0, 0), 0);
  int refused_at = -1;
  for (int i = 0; i < 200 && refused_at < 0; ++i)
    if (!line.add(nic_us(i * 3333.0, 0), i * 3333.0 + (i < 100 ? 0 : 5000))) refused_at = i;
  EXPECT_EQ(refused_at, 131);  // 32 in a row
}

}  // namespace
}  // namespace csipose
