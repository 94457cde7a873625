#include "proto/status.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <random>

namespace csipose {
namespace {

TEST(LatencyHistogram, IsEmptyAtFirst) {
  const LatencyHistogram histogram;
  EXPECT_EQ(histogram.count(), 0U);
  EXPECT_EQ(histogram.quantile_us(0.99), 0);
}

TEST(LatencyHistogram, AnEdgeBelongsToItsBucket) {
  LatencyHistogram histogram;
  histogram.add(1000);
  histogram.add(1001);
  histogram.add(999999);
  const auto edge = static_cast<std::size_t>(
      std::find(LatencyHistogram::kEdgesUs.begin(), LatencyHistogram::kEdgesUs.end(), 1000U) -
      LatencyHistogram::kEdgesUs.begin());
  EXPECT_EQ(histogram.at_most(edge), 1U);
  EXPECT_EQ(histogram.at_most(edge + 1), 2U);
  EXPECT_EQ(histogram.count(), 3U);
  EXPECT_EQ(histogram.sum_us(), 1002000U);
  EXPECT_EQ(histogram.max_us(), 999999U);
  EXPECT_EQ(histogram.quantile_us(1), 999999);
}

// Against the sorted sample: a quantile may be wrong by its bucket, no more.
TEST(LatencyHistogram, QuantilesAreThreePercentExact) {
  std::mt19937 random(7);
  std::lognormal_distribution<double> delay(9, 1.5);
  LatencyHistogram histogram;
  std::vector<std::uint32_t> all;
  for (int i = 0; i < 5000; ++i) {
    all.push_back(static_cast<std::uint32_t>(delay(random)));
    histogram.add(all.back());
  }
  std::sort(all.begin(), all.end());
  for (const double q : {0.001, 0.01, 0.5, 0.9, 0.99, 0.999}) {
    const std::uint32_t exact = all[static_cast<std::size_t>(std::lround(q * 5000)) - 1];
    EXPECT_NEAR(histogram.quantile_us(q), exact, 1 + exact / 32.0) << q;
  }
  EXPECT_EQ(histogram.quantile_us(1), all.back());
}

TEST(LatencyHistogram, ConstantDelayIsToldAsItIs) {
  LatencyHistogram histogram;
  for (int i = 0; i < 1000; ++i) histogram.add(50000);
  EXPECT_NEAR(histogram.quantile_us(0.5), 50000, 50000 / 32.0);
  EXPECT_EQ(histogram.quantile_us(0.99), 50000);
}

TEST(LatencyHistogram, TakesTheLongestDelay) {
  LatencyHistogram histogram;
  histogram.add(UINT32_MAX);
  EXPECT_EQ(histogram.max_us(), UINT32_MAX);
  EXPECT_EQ(histogram.at_most(LatencyHistogram::kEdgesUs.size() - 1), 0U);
}

}  // namespace
}  // namespace csipose
