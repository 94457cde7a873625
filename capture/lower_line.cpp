#include "capture/lower_line.h"

#include <algorithm>
#include <cmath>

namespace csipose {

namespace {
// Under four buckets the slope of minima is worse than the expected one: at 1 s a bucket, 250 us of jitter
// are 60 ppm.
constexpr std::size_t kMinBucketsForSlope = 4;
}  // namespace

void LowerLine::add(double x, double y) {
  if (count_ == 0) {
    origin_x_ = x;
    origin_y_ = y;
    intercept_ = 0;
  }
  const Point point{x - origin_x_, (y - origin_y_) - config_.slope * (x - origin_x_)};
  const auto bucket = static_cast<std::int64_t>(std::floor(point.x / config_.bucket));
  if (count_ == 0 || bucket > bucket_) return open_bucket(bucket, point);
  if (bucket < bucket_ || above_line(point) >= above_line(newest())) return;
  newest() = point;
  intercept_ = std::min(intercept_, above_line(point));
}

void LowerLine::open_bucket(std::int64_t bucket, const Point& point) {
  if (count_ >= kMinBucketsForSlope) fit_slope();
  bucket_ = bucket;
  if (count_ == kBuckets)
    first_ = (first_ + 1) % kBuckets;
  else
    ++count_;
  newest() = point;
  let_down();
}

void LowerLine::fit_slope() {
  std::array<double, kBuckets*(kBuckets - 1) / 2> slopes{};
  std::size_t n = 0;
  for (std::size_t i = 1; i < count_; ++i)
    for (std::size_t j = 0; j < i; ++j) slopes[n++] = (at(i).z - at(j).z) / (at(i).x - at(j).x);
  const auto median = slopes.begin() + static_cast<std::ptrdiff_t>(n / 2);
  std::nth_element(slopes.begin(), median, slopes.begin() + static_cast<std::ptrdiff_t>(n));
  if (std::abs(*median) <= config_.slope_tolerance * std::abs(config_.slope)) slope_correction_ = *median;
}

void LowerLine::let_down() {
  intercept_ = above_line(at(0));
  for (std::size_t i = 1; i < count_; ++i) intercept_ = std::min(intercept_, above_line(at(i)));
}

}  // namespace csipose
