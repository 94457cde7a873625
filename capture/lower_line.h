// capture/lower_line.h - the straight line under a cloud of delayed points: what a clock says once delays are
// taken off.
//
// A packet's arrival is never early, only late: arrival = true time + shortest path + queueing >= 0. So the
// truth is the lower edge of the cloud, and least squares through all points would follow the queues instead
// (on 1.2 s of arrivals with rare stalls it errs by 80 to 1,300 ppm). Each bucket of x keeps its lowest
// point; the slope is the median of all slopes between these (Theil and Sen), which a bucket that saw only
// late points cannot bend; the line is then let down on the lowest of them.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>

namespace csipose {

class LowerLine {
 public:
  static constexpr std::size_t kBuckets = 32;  ///< how far the line remembers, in buckets with points in them

  struct Config {
    double bucket;           ///< width of a bucket, units of x
    double slope;            ///< expected dy/dx
    double slope_tolerance;  ///< a fitted slope further off than this part of `slope` is refused and the last
                             ///< one kept
  };
  explicit LowerLine(const Config& config) : config_(config) {}

  /// x must not run backwards by more than a bucket: an older point says nothing new and is passed over.
  ///   cost  O(1); O(kBuckets^2) once per bucket
  void add(double x, double y);
  /// Forgets the points; the slope stays the best guess.
  void restart() { count_ = 0; }

  bool known() const { return count_ > 0; }
  /// Both require known().
  double y_at(double x) const { return origin_y_ + intercept_ + slope() * (x - origin_x_); }
  double x_at(double y) const { return origin_x_ + (y - origin_y_ - intercept_) / slope(); }
  double slope() const { return config_.slope + slope_correction_; }

 private:
  /// A bucket's lowest point, relative to the origin and to the expected slope.
  struct Point {
    double x, z;
  };
  double above_line(const Point& p) const { return p.z - slope_correction_ * p.x; }
  Point& newest() { return points_[(first_ + count_ - 1) % kBuckets]; }
  const Point& at(std::size_t i) const { return points_[(first_ + i) % kBuckets]; }
  void open_bucket(std::int64_t bucket, const Point& point);
  void fit_slope();
  void let_down();

  Config config_;
  double origin_x_ = 0,
         origin_y_ = 0;  // keeps differences small enough for a double to hold nanoseconds of days
  double slope_correction_ = 0, intercept_ = 0;
  std::array<Point, kBuckets> points_{};
  std::size_t first_ = 0, count_ = 0;
  std::int64_t bucket_ = 0;  // the newest one
};

}  // namespace csipose
