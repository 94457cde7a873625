// model/accuracy_gate.h - how far a lower precision moves the joints, and how far it may.
//
// The figure: for each window, each of the five people that the float32 network is surest of is looked up
// among the ten that the lower precision is surest of (an order may change where scores are close); the
// distance is the mean over the 14 joints to the nearest of them. Mean and maximum run over all people and
// windows.
#pragma once

#include <cstdint>
#include <span>
#include <string>
#include <vector>

#include "model/engine.h"
#include "model/model.h"

namespace csipose {

/// A precision passes when its error on labelled windows is at most this much above float32's. A person may be moved by more
/// than that: what float32 says of him is as uncertain.
inline constexpr double kMostErrorRatio = 1.01;
/// Without labels it passes when it moves joints by no more than this on average. The best published errors of such
/// a network are 70-90 mm per joint: 5 mm that are not correlated with them add less than 0.3 %.
inline constexpr double kMostJointShift_m = 0.005;
inline bool passes_gate(const GateFigures& figures) {
  if (figures.labelled) return figures.labelled->mpjpe_m <= kMostErrorRatio * figures.labelled->f32_mpjpe_m;
  return figures.mean_joint_shift_m <= kMostJointShift_m;
}
/// "moves joints by 21.3 mm on average; 375.0 mm off labelled people where f32 is 374.7: at most 1 % more is allowed".
std::string words_for(const GateFigures& figures);

/// [60][20][9] as Window::x.
using WindowTensor = std::vector<float>;

/// Windows of noise with the amplitudes and phases that the model was told to expect; for a model that brings
/// no figures.
std::vector<WindowTensor> noise_windows(const Normalisation& normalisation, std::size_t count,
                                        std::uint64_t seed);

/// All nine links are present. Never NaN: what is not a number counts as infinitely far.
GateFigures measure_shift(Engine& exact, Engine& other, std::span<const WindowTensor> windows);

}  // namespace csipose
