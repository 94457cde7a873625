// train/schedules.h - how learning rate, weight decay and the target's momentum move over a run. Pure functions.
//
// `step` is 1-based: the step that is about to be made. `total` is the number of steps of the whole run.
#pragma once

#include <cmath>
#include <cstdint>
#include <numbers>

namespace csipose::train {

/// Linear from `start` to `peak` over the first `warm_up` steps, then a half cosine down to `final`.
/// source: facebookresearch/ijepa, WarmupCosineSchedule
struct WarmUpCosine {
  double start = 1e-4, peak = 5e-4, final = 1e-6;
  double at(std::uint64_t step, std::uint64_t warm_up, std::uint64_t total) const {
    const auto s = static_cast<double>(step), w = static_cast<double>(warm_up),
               t = static_cast<double>(total);
    if (step < warm_up) return start + s / w * (peak - start);
    const double progress = (s - w) / std::max(1., t - w);
    return std::max(final, final + (peak - final) * (1 + std::cos(std::numbers::pi * progress)) / 2);
  }
};

/// A half cosine from `from` to `to`: weight decay of I-JEPA, learning rate of short fine-tuning runs.
inline double half_cosine(double from, double to, std::uint64_t step, std::uint64_t total) {
  const double progress = static_cast<double>(step) / static_cast<double>(total);
  return to + (from - to) * (1 + std::cos(std::numbers::pi * progress)) / 2;
}

/// Rises linearly to 1 over the first `share` of the steps, and stays there.
inline double warm_up_factor(double share, std::uint64_t step, std::uint64_t total) {
  const double steps = share * static_cast<double>(total);
  return static_cast<double>(step) < steps ? static_cast<double>(step) / steps : 1;
}

/// Momentum of the target encoder, from `from` to 1 over the run: by cosine as the paper, or linear as I-JEPA's code.
inline double momentum_cosine(double from, std::uint64_t step, std::uint64_t total) {
  const double progress = static_cast<double>(step - 1) / static_cast<double>(total);
  return 1 - (1 - from) * (std::cos(std::numbers::pi * progress) + 1) / 2;
}
inline double momentum_linear(double from, std::uint64_t step, std::uint64_t total) {
  return from + (1 - from) * static_cast<double>(step - 1) / static_cast<double>(total);
}

}  // namespace csipose::train
