#include "proto/status.h"

#include <algorithm>
#include <bit>
#include <numeric>

namespace csipose {

void LatencyHistogram::add(std::uint32_t us) {
  const auto edge = std::lower_bound(kEdgesUs.begin(), kEdgesUs.end(), us);
  ++buckets_[static_cast<std::size_t>(edge - kEdgesUs.begin())];
  ++fine_[fine_bucket(us)];
  ++count_;
  sum_us_ += us;
  max_us_ = std::max(max_us_, us);
}

std::uint64_t LatencyHistogram::at_most(std::size_t edge) const {
  return std::accumulate(buckets_.begin(), buckets_.begin() + static_cast<std::ptrdiff_t>(edge) + 1,
                         std::uint64_t{0});
}

/// Below 64 a bucket for each value; above, the five bits after the leading one choose among 32.
std::size_t LatencyHistogram::fine_bucket(std::uint32_t us) {
  const std::uint32_t value = std::min(us, kFineLimitUs);
  const int shift = std::max(0, static_cast<int>(std::bit_width(value)) - 6);
  return static_cast<std::size_t>(shift) * 32 + (value >> shift);
}

double LatencyHistogram::fine_begin_us(std::size_t bucket) {
  if (bucket < 64) return static_cast<double>(bucket);
  const std::size_t shift = bucket / 32 - 1;
  return static_cast<double>((bucket - shift * 32) << shift);
}

double LatencyHistogram::quantile_us(double q) const {
  const double rank = q * static_cast<double>(count_);
  double below = 0;
  for (std::size_t b = 0; b < fine_.size(); ++b) {
    const auto here = static_cast<double>(fine_[b]);
    if (here > 0 && below + here >= rank) {
      const double begin = fine_begin_us(b), end = fine_begin_us(b + 1);
      return std::min<double>(begin + (end - begin) * (rank - below) / here, max_us_);
    }
    below += here;
  }
  return max_us_;
}

}  // namespace csipose
