#include "proto/status.h"

#include <algorithm>
#include <numeric>

namespace csipose {

void LatencyHistogram::add(std::uint32_t us) {
  const auto edge = std::lower_bound(kEdgesUs.begin(), kEdgesUs.end(), us);
  ++buckets_[static_cast<std::size_t>(edge - kEdgesUs.begin())];
  ++count_;
  sum_us_ += us;
  max_us_ = std::max(max_us_, us);
}

std::uint64_t LatencyHistogram::at_most(std::size_t edge) const {
  return std::accumulate(buckets_.begin(), buckets_.begin() + static_cast<std::ptrdiff_t>(edge) + 1,
                         std::uint64_t{0});
}

double LatencyHistogram::quantile_us(double q) const {
  const double rank = q * static_cast<double>(count_);
  double below = 0;
  for (std::size_t b = 0; b < buckets_.size(); ++b) {
    const auto here = static_cast<double>(buckets_[b]);
    if (here > 0 && below + here >= rank) {
      const double low = b == 0 ? 0 : kEdgesUs[b - 1];
      const double high = b < kEdgesUs.size() ? std::min(kEdgesUs[b], max_us_) : max_us_;
      return low + (high - low) * (rank - below) / here;
    }
    below += here;
  }
  return max_us_;
}

}  // namespace csipose
