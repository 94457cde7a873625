#include "proto/status.h"

#include <gtest/gtest.h>

#include <algorithm>
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

// Against the sorted sample: an interpolated quantile may be wrong by its bucket, no more.
TEST(LatencyHistogram, QuantilesLieInTheRightBucket) {
  std::mt19937 random(7);
  std::lognormal_distribution<double> delay(9, 0.6);
  LatencyHistogram histogram;
  std::vector<std::uint32_t> all;
  for (int i = 0; i < 5000; ++i) {
    all.push_back(static_cast<std::uint32_t>(delay(random)));
    histogram.add(all.back());
  }
  std::sort(all.begin(), all.end());
  for (const double q : {0.01, 0.5, 0.9, 0.99, 0.999}) {
    const std::uint32_t exact = all[static_cast<std::size_t>(q * 5000) - 1];
    const auto& edges = LatencyHistogram::kEdgesUs;
    const auto above = std::lower_bound(edges.begin(), edges.end(), exact);
    const double low = above == edges.begin() ? 0 : *(above - 1), high = above == edges.end() ? 1e9 : *above;
    EXPECT_GE(histogram.quantile_us(q), low) << q;
    EXPECT_LE(histogram.quantile_us(q), high) << q;
  }
}

}  // namespace
}  // namespace csipose
