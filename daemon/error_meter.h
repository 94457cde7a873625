// daemon/error_meter.h - how far poses are from the truth, frame after frame, beside what a guess without any radio scores.
//
// In each frame people and truth are paired so that the sum of their distances (mean over the joints) is least; a pair further
// apart than half a metre is none. The guess claims as many people as there were most often so far, each with the mean of all
// true poses so far: what somebody would say who knows the room and its people and does not look.
#pragma once

#include <array>
#include <cstdint>
#include <span>
#include <vector>

#include "model/assignment.h"
#include "proto/truth.h"

namespace csipose {

inline constexpr double kMatchGate_m = 0.5;

/// Sums over frames.
struct ErrorSums {
  std::uint64_t frames = 0, count_right = 0;  ///< frames; of these with as many claimed as there were
  std::uint64_t people = 0, claimed = 0, matched = 0;
  double error_m = 0;  ///< sum over matched people of their mean joint error

  double mean_error_m() const;           ///< of matched people; NaN when nobody was
  double found_ratio() const;            ///< matched of those who were there; NaN when nobody was
  double claimed_rightly_ratio() const;  ///< matched of those who were claimed; NaN when nobody was
  double count_right_ratio() const;
};

/// What one frame adds.
struct FrameError {
  std::size_t people = 0, claimed = 0, matched = 0;
  double error_m = 0;  ///< sum over the matched
};

class ErrorMeter {
 public:
  ErrorMeter();
  FrameError add(std::span<const Skeleton> claimed, std::span<const Skeleton> truth);
  const ErrorSums& poses() const { return poses_; }
  const ErrorSums& guess() const { return guess_; }

 private:
  FrameError compare(std::span<const Skeleton> claimed, std::span<const Skeleton> truth);
  std::vector<Skeleton> guess_now() const;
  void learn(std::span<const Skeleton> truth);

  Assignment assignment_;
  ErrorSums poses_, guess_;
  std::array<std::array<double, 3>, kJoints> pose_sum_{};
  std::uint64_t poses_seen_ = 0;
  std::array<std::uint64_t, kMaxTruePeople + 1> counts_{};  ///< frames with so many people
};

}  // namespace csipose
