// model/normalisation.h - a window's numbers as the network is given them.
//
// Two ways. By three scalars: (amplitude - mean) / deviation and phase / deviation, alike for all channels and links. Or
// against a background: what an installation (a room, its receivers, and the phases between their antennas, which each
// powering up of the cards leaves otherwise) shows on average. For people who are weak beside the static paths, deviations of amplitude and phase from it are,
// to first order, the two components of what people add, turned by the static path; so what the cards contribute to either
// falls out.
#pragma once

#include <array>
#include <span>
#include <string>
#include <vector>

#include "proto/window.h"

namespace csipose {

inline constexpr std::size_t kElements = kChannels * kLinks;
inline constexpr std::size_t kFirstPhase =
    kSubcarriers * kLinks;                            // of the elements; amplitudes come before it
inline constexpr std::size_t kMostBackgrounds = 256;  // of a weights file

/// Mean and deviation of each channel of each link, [c * 9 + l]: amplitudes as in Window::x, phases in radians, their mean on
/// the circle.
struct Background {
  std::string name;  ///< of the installation; for people
  std::array<float, kElements> mean{}, deviation{};
};

/// Applied by the engines, not by the caller.
struct Normalisation {
  float amp_mean = 0, amp_std = 1, ph_std = 1;
  std::vector<Background> backgrounds{};  ///< not empty: the scalars are not used
};

/// The background of which the window (Window::x) is likeliest to come, and how unlike it the window is.
struct NearestBackground {
  const Background* background = nullptr;
  /// Mean square of the deviations of the window's mean over time, in units of the background's: about 1 where it fits.
  double unlikeness = 0;
};
/// Elements of the links `links` taken as independent and normal. Of no background: nullptr. Costs 60 x 20 x 9 additions and
/// 60 x 9 steps for each background.
NearestBackground nearest_background(const std::vector<Background>& backgrounds, std::span<const float> x,
                                     LinkSet links);

/// Tokens of the links `links`, rows t * 9 + l without those left out, of 60 numbers each; against `background`, or by the
/// scalars when it is nullptr.
void write_tokens(const Normalisation& normalisation, const Background* background, std::span<const float> x,
                  LinkSet links, std::span<float> tokens);

/// phase, brought to [-pi, pi] by whole turns; |phase| < 3 pi.
inline float wrapped(float phase) {
  constexpr float kTurn = 6.2831853f, kHalf = 3.1415927f;
  if (phase > kHalf) return phase - kTurn;
  return phase < -kHalf ? phase + kTurn : phase;
}

}  // namespace csipose
