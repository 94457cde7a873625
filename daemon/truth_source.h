// daemon/truth_source.h - where simulated people really were at a given time, for viewers and error meters; from the simulator
// itself (truth_client.h) or as a recording holds it (truth_recording.h).
#pragma once

#include <algorithm>
#include <deque>
#include <string>

#include "proto/truth.h"

namespace csipose {

class TruthSource {
 public:
  virtual ~TruthSource() = default;
  /// What is simulated, and in which room; nullptr when that is not said.
  virtual const TruthHello* hello() const = 0;
  /// Takes what has come; never waits. Throws SetupError when it is no truth.
  virtual void drain() = 0;
  /// The instant nearest to `time`, if one lies within a packet's spacing of it; nullptr otherwise. Times ascend. Valid until the
  /// next call.
  virtual const Truth* at(UtcTime time) = 0;
  /// Of how long ago `truth` tells, as the viewer's time goes.
  virtual double age_s(const Truth& truth) const = 0;
  /// Why there is nothing to show, for people.
  virtual std::string silence() const = 0;
  const Truth* newest() const { return kept_.empty() ? nullptr : &kept_.back(); }

 protected:
  static constexpr auto kKept = std::chrono::seconds(3);  // longer than any pose is under way

  void keep(Truth truth) {
    kept_.push_back(std::move(truth));
    while (kept_.back().sent - kept_.front().sent > kKept) kept_.pop_front();
  }
  const Truth* nearest(UtcTime time, double spacing_s) const {
    const auto apart_ns = [&](const Truth& truth) { return std::abs(ns(truth.sent - time)); };
    const auto found = std::ranges::min_element(kept_, {}, apart_ns);
    return found == kept_.end() || static_cast<double>(apart_ns(*found)) > 1e9 * spacing_s ? nullptr
                                                                                           : &*found;
  }
  /// Mean time between what is kept; 0 with less than two.
  double kept_spacing_s() const {
    return kept_.size() < 2
               ? 0
               : seconds(kept_.back().sent - kept_.front().sent) / static_cast<double>(kept_.size() - 1);
  }

 private:
  std::deque<Truth> kept_;  // of the last seconds, ascending in time
};

}  // namespace csipose
