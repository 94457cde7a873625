#include "model/accuracy_gate.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <numbers>
#include <random>

namespace csipose {
namespace {

constexpr std::size_t kPeople = 5, kCandidates = 10;

using Poses = std::vector<std::vector<float>>;

/// The `count` poses with the highest logits.
Poses surest(const NetworkOutput& output, std::size_t count) {
  std::vector<std::size_t> order(output.logits.size());
  for (std::size_t i = 0; i < order.size(); ++i) order[i] = i;
  const auto logit = [&](std::size_t q) {
    return std::isnan(output.logits[q]) ? -HUGE_VALF : output.logits[q];
  };
  std::stable_sort(order.begin(), order.end(),
                   [&](std::size_t a, std::size_t b) { return logit(a) > logit(b); });
  order.resize(std::min(count, order.size()));
  Poses poses;
  for (const std::size_t q : order) {
    const auto pose = output.poses.subspan(q * kPoseWidth, kPoseWidth);
    poses.emplace_back(pose.begin(), pose.end());
  }
  return poses;
}

double mean_joint_distance(const std::vector<float>& a, const std::vector<float>& b) {
  double sum = 0;
  for (std::size_t j = 0; j < kJoints; ++j)
    sum += std::hypot(double{a[3 * j]} - b[3 * j], double{a[3 * j + 1]} - b[3 * j + 1],
                      double{a[3 * j + 2]} - b[3 * j + 2]);
  return sum / kJoints;
}

double distance_to_nearest(const std::vector<float>& pose, const Poses& others) {
  double nearest = std::numeric_limits<double>::infinity();
  for (const std::vector<float>& other : others) {
    const double distance = mean_joint_distance(pose, other);
    if (distance < nearest) nearest = distance;
  }
  return nearest;
}

}  // namespace

std::vector<WindowTensor> noise_windows(const Normalisation& n, std::size_t count, std::uint64_t seed) {
  std::mt19937_64 random(seed);
  std::normal_distribution<float> amplitude(n.amp_mean, n.amp_std);
  std::uniform_real_distribution<float> phase(-std::numbers::pi_v<float>, std::numbers::pi_v<float>);
  std::vector<WindowTensor> windows(count, WindowTensor(kChannels * kTokens));
  for (WindowTensor& window : windows)
    for (std::size_t i = 0; i < window.size(); ++i)
      window[i] = i < kSubcarriers * kTokens ? std::max(0.f, amplitude(random)) : phase(random);
  return windows;
}

std::string words_for(const GateFigures& figures) {
  const std::string shift =
      fmt::format("moves joints by {:.2f} mm on average", 1e3 * figures.mean_joint_shift_m);
  if (!figures.labelled) return fmt::format("{}, {:.0f} mm are allowed", shift, 1e3 * kMostJointShift_m);
  return fmt::format(
      "{}; is {:.1f} mm off labelled people where f32 is {:.1f} mm off, {:.0f} % more are allowed", shift,
      1e3 * figures.labelled->mpjpe_m, 1e3 * figures.labelled->f32_mpjpe_m, 100 * (kMostErrorRatio - 1));
}

GateFigures measure_shift(Engine& exact, Engine& other, std::span<const WindowTensor> windows) {
  GateFigures figures;
  std::size_t people = 0;
  for (const WindowTensor& window : windows) {
    const LinkSet all = LinkSet().set();
    const Poses wanted = surest(exact.run(window, all), kPeople);
    const Poses given = surest(other.run(window, all), kCandidates);
    for (const std::vector<float>& pose : wanted) {
      const double shift_m = distance_to_nearest(pose, given);
      figures.mean_joint_shift_m += shift_m;
      figures.max_joint_shift_m = std::max(figures.max_joint_shift_m, shift_m);
    }
    people += wanted.size();
    ++figures.windows;
  }
  if (people > 0) figures.mean_joint_shift_m /= static_cast<double>(people);
  return figures;
}

}  // namespace csipose
