// capture/pair_line.h - one receiver's radio clock on the common axis, from frames that both have heard.
//
// Channel access delays a frame by tens of microseconds, but by the same for all who hear it: the difference
// of two receivers' times for one frame is a straight line with residuals of a microsecond, whatever queues
// the packets stood in later. Pairs are averaged in buckets of time and a line is fitted through these.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>

namespace csipose {

class PairLine {
 public:
  /// Starts anew with one known pair; until pairs come the clock is taken to run like the axis.
  void anchor(std::int64_t nic_us, double axis_us);
  void reset() { anchored_ = false; }
  bool anchored() const { return anchored_; }

  /// Takes a matched pair. One far off the line is left out; many of these in a row mean that the line is
  /// wrong: false, and it is to be anchored anew.
  [[nodiscard]] bool add(std::int64_t nic_us, double axis_us);

  /// Requires anchored().
  double axis_at(std::int64_t nic_us) const;
  /// How much faster than the axis this clock runs.
  double skew() const { return -slope_; }
  /// Root mean square of the pairs' distance from the line, microseconds; meaningful from kMinPairs on.
  double residual_us() const;
  std::uint64_t pairs() const { return pairs_; }
  static constexpr std::uint64_t kMinPairs = 8;

 private:
  static constexpr std::size_t kBuckets = 128;
  struct Bucket {
    double n = 0, x = 0, d = 0;  // pairs, mean time since the anchor, mean of axis less that
  };
  void collect(double x, double d);
  void fit();

  bool anchored_ = false;
  std::int64_t anchor_us_ = 0;
  double intercept_ = 0, slope_ = 0;
  std::array<Bucket, kBuckets> buckets_{};
  std::size_t newest_ = 0, count_ = 0;
  double mean_square_ = 0;
  std::uint64_t pairs_ = 0;
  int outliers_ = 0;
};

}  // namespace csipose
