#include "capture/lower_line.h"

#include <gtest/gtest.h>

#include <cmath>
#include <random>

namespace csipose {
namespace {

constexpr LowerLine::Config kOneToOne{.bucket = 1, .slope = 1, .slope_tolerance = 1e-3};

/// y = x + delay, the clock of y running fast by `skew`.
void add_points(LowerLine& line, double from, double to, double skew, unsigned seed,
                double mean_delay = 250e-6) {
  std::mt19937 random(seed);
  std::exponential_distribution<double> delay(1 / mean_delay);
  for (double x = from; x < to; x += 1.0 / 300) line.add(x, 7 + x * (1 + skew) + delay(random));
}

TEST(LowerLine, TheFirstPointIsTheLine) {
  LowerLine line(kOneToOne);
  EXPECT_FALSE(line.known());
  line.add(5, 100);
  ASSERT_TRUE(line.known());
  EXPECT_EQ(line.y_at(5), 100);
  EXPECT_EQ(line.y_at(6), 101);
  EXPECT_EQ(line.x_at(103), 8);
}

TEST(LowerLine, LiesUnderTheDelays) {
  LowerLine line(kOneToOne);
  add_points(line, 0, 30, 20e-6, 1);
  EXPECT_NEAR(line.slope() - 1, 20e-6, 0.5e-6);
  EXPECT_NEAR(line.y_at(30), 7 + 30 * (1 + 20e-6), 20e-6);
  EXPECT_NEAR(line.x_at(line.y_at(12.5)), 12.5, 1e-9);
}

TEST(LowerLine, AStallOfWholeBucketsDoesNotBendIt) {
  LowerLine line(kOneToOne);
  add_points(line, 0, 10, 0, 2);
  for (double x = 10; x < 14; x += 0.01) line.add(x, 7 + x + 0.025);
  add_points(line, 14, 20, 0, 3);
  EXPECT_NEAR(line.slope() - 1, 0, 2e-6);
  EXPECT_NEAR(line.y_at(20), 27, 20e-6);
}

TEST(LowerLine, RefusesASlopeBeyondItsTolerance) {
  LowerLine line({.bucket = 1, .slope = 1, .slope_tolerance = 40e-6});
  for (double x = 0; x < 20; x += 0.01) line.add(x, x * 1.0002);
  EXPECT_EQ(line.slope(), 1);
}

TEST(LowerLine, ForgetsWhatIsOlderThanItsBuckets) {
  LowerLine line(kOneToOne);
  line.add(0, -5);  // impossibly early
  for (double x = 0.5; x < 31; x += 0.5) line.add(x, x);
  EXPECT_LT(line.y_at(31), 31 - 4);
  for (double x = 31; x < 34; x += 0.5) line.add(x, x);
  EXPECT_NEAR(line.y_at(34), 34, 1e-9);
}

TEST(LowerLine, OlderPointsArePassedOver) {
  LowerLine line(kOneToOne);
  line.add(10, 10);
  line.add(12, 12);
  line.add(10.5, 3);
  EXPECT_EQ(line.y_at(12), 12);
}

TEST(LowerLine, KeepsItsSlopeOverARestart) {
  LowerLine line(kOneToOne);
  for (double x = 0; x < 20; x += 0.1) line.add(x, x * 1.0005);
  line.restart();
  EXPECT_FALSE(line.known());
  line.add(1000, 0);
  EXPECT_NEAR(line.y_at(1010), 10.005, 1e-6);
}

}  // namespace
}  // namespace csipose
