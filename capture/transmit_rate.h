// capture/transmit_rate.h - how many frames a second the transmitter sends, from some thirty frames of one
// receiver.
#pragma once

#include <cstdint>
#include <optional>
#include <span>

namespace csipose {

inline constexpr std::size_t kRateFrames = 33;

struct TimedCounter {
  double time_s;
  std::uint64_t counter;
};
/// From counters (below `modulus`; 0 = 2^64): the median over pairs half the frames apart, which losses do
/// not touch and a pause within a few of them neither.
///   returns  nullopt for what no transmitter does: standing still, running back, over 20,000 frames a second
std::optional<double> transmit_rate_hz(std::span<const TimedCounter> frames, std::uint64_t modulus);

/// From times alone: the median gap is one period, and every short gap a whole number of them. Right while
/// less than half of the frames are lost.
std::optional<double> transmit_rate_hz(std::span<const double> times_s);

}  // namespace csipose
