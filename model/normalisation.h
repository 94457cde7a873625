// model/normalisation.h - a window's numbers as the network is given them.
//
// Two ways. By three scalars: (amplitude - mean) / deviation and phase / deviation, alike for all channels and links. Or
// against a background: the response that an installation (a room, its receivers, and the gains and phases of their branches,
// which each powering up of the cards leaves otherwise) shows on average. A sample's channel response H is brought over
// that of the background, B, receiver by receiver; what is left, turned by B's phase, is what people add to the static paths.
// In the complex plane people add up, however strong they are beside those paths, and the branches' phases and gains fall out.
#pragma once

#include <array>
#include <span>
#include <string>
#include <vector>

#include "model/config.h"
#include "proto/window.h"

namespace csipose {

inline constexpr std::size_t kElements = kChannels * kLinks;
inline constexpr std::size_t kFirstPhase =
    kSubcarriers * kLinks;                            // of the elements; amplitudes come before it
inline constexpr std::size_t kMostBackgrounds = 256;  // of a weights file

/// Of each channel of each link, [c * 9 + l]. What goes by subcarrier and link as two numbers, in phase with the response and
/// across it, has the first in the place of the amplitude and the second in that of the phase.
struct Background {
  std::string name;                          ///< of the installation; for people
  std::array<float, kElements> response{};   ///< amplitudes as in Window::x, phases in radians
  std::array<float, kElements> deviation{};  ///< root mean square of the departures, in phase and across
};

/// How a sample departs from the response: g H exp(-i (a + b (n - 14.5))) exp(-i arg B) - |B| for the subcarriers n = 0 .. 29,
/// the real part in phase and the imaginary part across. a and b, of a receiver, make |sum H conj(B) exp(-i ..)| over its
/// present links largest, b within +-0.475 rad (a whole turn that cleaning put into the middle of three antennas makes a slope of
/// 0.31); g then makes the squares of the departures least. So the phase line of the packet, its power and its cleaning fall out: it
/// does not matter where phases were unwrapped. `sample` is [c * 9 + l]; elements of links that are not there are 0. Costs
/// 3 x 24 x 30 complex multiplications and 270 sines and cosines.
std::array<float, kElements> departures(const Background& background, std::span<const float> sample,
                                        LinkSet links);

// How b is looked for: the best of a grid around 0, closer than half the width of the peak that a line of 30 subcarriers has, then
// Newton's steps, each of at most half of the grid's.
inline constexpr std::size_t kSlopes = 19;
inline constexpr float kSlopeStep = 0.05f;  ///< radians from one subcarrier to the next
inline constexpr int kNewtonSteps = 2;
inline constexpr float kMiddleSubcarrier = (kSubcarriers - 1) / 2.f;
/// Of the grid.
constexpr float slope_of(std::size_t i) { return (static_cast<float>(i) - (kSlopes - 1) / 2.f) * kSlopeStep; }

/// Applied by the engines, not by the caller.
struct Normalisation {
  float amp_mean = 0, amp_std = 1, ph_std = 1;
  std::vector<Background> backgrounds{};  ///< not empty: the scalars are not used
};

// Somebody close to a link makes departures many times the usual: elements are taken as independent and of Student's t with three
// degrees of freedom, whose density falls as (1 + z^2 / 3)^-2.
inline constexpr double kFreedom = 3, kTailShape = (kFreedom + 1) / 2;
/// How well a sample goes with a background.
struct Fit {
  /// Mean square of the departures, in units of the background's deviations: about 1 where it fits.
  double unlikeness = 0;
  /// Less by x: likelier by exp(x), of samples with the same links.
  double surprise = 0;
};
/// Elements of the links `links` only. Costs departures().
Fit fit_of(const Background& background, std::span<const float> sample, LinkSet links);

using WindowSample = std::array<float, kElements>;
/// [c * 9 + l].
WindowSample middle_sample(std::span<const float> x);

/// The background of which the window's middle sample is likeliest to come, and how unlike it that is. Over many windows:
/// model/installation_finder.h.
struct NearestBackground {
  const Background* background = nullptr;
  double unlikeness = 0;  ///< as in Fit
};
/// Of no background: nullptr.
NearestBackground nearest_background(const std::vector<Background>& backgrounds, std::span<const float> x,
                                     LinkSet links);

/// How much people move each channel of each link, beside the response itself: deviation / (|B| + deviation), in phase and
/// across, in 0 .. 1. A branch's gain and phase fall out, so it is nearly the same after another powering up: what is left tells one
/// room from another, and which subcarriers of a link people reach.
std::array<float, kElements> mobility(const Background& background);

/// The tokens that config.tokens_there(links) names, in that order; against `background`, or by the scalars when it is nullptr. Of
/// 60 numbers for each link or, with background_conditioning, of 120: the link's mobility() follows, 0 where there is no background.
/// Where a token has several links (NetworkConfig::token_link) they stand side by side, all numbers of one that is not there 0.
void write_tokens(const NetworkConfig& config, const Normalisation& normalisation,
                  const Background* background, std::span<const float> x, LinkSet links,
                  std::span<float> tokens);

}  // namespace csipose
