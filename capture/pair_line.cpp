#include "capture/pair_line.h"

#include <algorithm>
#include <cmath>

namespace csipose {

namespace {
constexpr double kBucketUs = 1e5;    // times PairLine::kBuckets: the last 13 s, in which crystals hold still
constexpr double kMaxSlope = 80e-6;  // two clocks within 40 ppm each
constexpr std::size_t kMinBucketsForSlope = 4;
constexpr double kOutlierUs = 1000;  // a pair this far off is no pair: timestamps are good to a microsecond
constexpr int kMaxOutliers = 32;
constexpr double kResidualMemory = 256;  // pairs
}  // namespace

void PairLine::anchor(std::int64_t nic_us, double axis_us) {
  *this = PairLine{};
  anchored_ = true;
  anchor_us_ = nic_us;
  intercept_ = axis_us;
}

bool PairLine::add(std::int64_t nic_us, double axis_us) {
  const double error_us = axis_us - axis_at(nic_us);
  if (pairs_ >= kMinPairs && std::abs(error_us) > kOutlierUs) return ++outliers_ < kMaxOutliers;
  outliers_ = 0;
  const double x = static_cast<double>(nic_us - anchor_us_);
  collect(x, axis_us - x);
  fit();
  const double left_us = axis_us - axis_at(nic_us);
  ++pairs_;
  mean_square_ += (left_us * left_us - mean_square_) / std::min(static_cast<double>(pairs_), kResidualMemory);
  return true;
}

double PairLine::axis_at(std::int64_t nic_us) const {
  const double x = static_cast<double>(nic_us - anchor_us_);
  return x + intercept_ + slope_ * x;
}

double PairLine::residual_us() const { return std::sqrt(mean_square_); }

void PairLine::collect(double x, double d) {
  if (count_ == 0 || x - buckets_[newest_].x > kBucketUs) {
    newest_ = count_ == 0 ? 0 : (newest_ + 1) % kBuckets;
    count_ = std::min(count_ + 1, kBuckets);
    buckets_[newest_] = {};
  }
  Bucket& bucket = buckets_[newest_];
  bucket.n += 1;
  bucket.x += (x - bucket.x) / bucket.n;
  bucket.d += (d - bucket.d) / bucket.n;
}

void PairLine::fit() {
  double n = 0, x = 0, d = 0;
  for (std::size_t i = 0; i < count_; ++i) {
    const Bucket& b = buckets_[i];
    n += b.n, x += b.n * b.x, d += b.n * b.d;
  }
  x /= n, d /= n;
  double xx = 0, xd = 0;
  for (std::size_t i = 0; i < count_; ++i) {
    const Bucket& b = buckets_[i];
    xx += b.n * (b.x - x) * (b.x - x), xd += b.n * (b.x - x) * (b.d - d);
  }
  if (count_ >= kMinBucketsForSlope) slope_ = std::clamp(xd / xx, -kMaxSlope, kMaxSlope);
  intercept_ = d - slope_ * x;
}

}  // namespace csipose
