#include "daemon/error_meter.h"

#include <algorithm>
#include <cassert>
#include <cmath>

#include "proto/pose_geometry.h"

namespace csipose {
namespace {

double ratio(double part, std::uint64_t whole) {
  return whole == 0 ? kUnknown : part / static_cast<double>(whole);
}

void add_to(ErrorSums& sums, const FrameError& frame) {
  ++sums.frames;
  sums.count_right += frame.claimed == frame.people;
  sums.people += frame.people;
  sums.claimed += frame.claimed;
  sums.matched += frame.matched;
  sums.error_m += frame.error_m;
}

}  // namespace

double ErrorSums::mean_error_m() const { return ratio(error_m, matched); }
double ErrorSums::found_ratio() const { return ratio(static_cast<double>(matched), people); }
double ErrorSums::claimed_rightly_ratio() const { return ratio(static_cast<double>(matched), claimed); }
double ErrorSums::count_right_ratio() const { return ratio(static_cast<double>(count_right), frames); }

ErrorMeter::ErrorMeter() : assignment_(kMaxTruePeople, kMaxTruePeople) {}

FrameError ErrorMeter::add(std::span<const Skeleton> claimed, std::span<const Skeleton> truth) {
  const FrameError error = compare(claimed, truth);
  add_to(poses_, error);
  const std::vector<Skeleton> guess = guess_now();
  if (poses_seen_ > 0)
    add_to(guess_, compare(guess, truth));  // it knows nothing of a frame before it guesses
  learn(truth);
  return error;
}

FrameError ErrorMeter::compare(std::span<const Skeleton> claimed, std::span<const Skeleton> truth) {
  assert(claimed.size() <= kMaxTruePeople && truth.size() <= kMaxTruePeople);
  FrameError error{truth.size(), claimed.size(), 0, 0};
  if (claimed.empty() || truth.empty()) return error;
  constexpr double kFar_m = 1e6;
  std::vector<double> distance_m;
  for (const Skeleton& pose : claimed)
    for (const Skeleton& person : truth) {
      const double d = mean_joint_distance_m(pose, person);
      distance_m.push_back(d < kFar_m ? d : kFar_m);  // NaN is far
    }
  const auto partner = assignment_.solve(distance_m, claimed.size(), truth.size());
  for (std::size_t i = 0; i < claimed.size(); ++i) {
    if (partner[i] == kUnassigned) continue;
    const double d = distance_m[i * truth.size() + partner[i]];
    if (d > kMatchGate_m) continue;
    ++error.matched;
    error.error_m += d;
  }
  return error;
}

std::vector<Skeleton> ErrorMeter::guess_now() const {
  if (poses_seen_ == 0) return {};
  const auto usual = std::max_element(counts_.begin(), counts_.end()) - counts_.begin();
  Skeleton mean;
  for (std::size_t j = 0; j < kJoints; ++j) {
    const auto n = static_cast<double>(poses_seen_);
    const auto& sum = pose_sum_[j];
    mean[j] = {static_cast<float>(sum[0] / n), static_cast<float>(sum[1] / n),
               static_cast<float>(sum[2] / n)};
  }
  return std::vector<Skeleton>(static_cast<std::size_t>(usual), mean);
}

void ErrorMeter::learn(std::span<const Skeleton> truth) {
  ++counts_[truth.size()];
  for (const Skeleton& person : truth) {
    ++poses_seen_;
    for (std::size_t j = 0; j < kJoints; ++j) {
      pose_sum_[j][0] += person[j].x;
      pose_sum_[j][1] += person[j].y;
      pose_sum_[j][2] += person[j].z;
    }
  }
}

}  // namespace csipose
