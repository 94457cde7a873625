#include "capture/transmit_rate.h"

#include <algorithm>
#include <array>
#include <cassert>
#include <cmath>

namespace csipose {

namespace {
constexpr double kMaxHz = 20'000, kMinHz = 0.1;
constexpr double kMaxGap = 8;  // periods

std::optional<double> if_possible(double hz) {
  return hz >= kMinHz && hz <= kMaxHz ? std::optional(hz) : std::nullopt;  // false for NaN, too
}

double median(std::span<double> values) {
  const auto middle = values.begin() + static_cast<std::ptrdiff_t>(values.size() / 2);
  std::nth_element(values.begin(), middle, values.end());
  return *middle;
}
}  // namespace

std::optional<double> transmit_rate_hz(std::span<const TimedCounter> frames, std::uint64_t modulus) {
  assert(frames.size() >= 2 && frames.size() <= kRateFrames);
  const std::size_t apart = frames.size() / 2;
  std::array<double, kRateFrames> rates{};
  std::size_t n = 0;
  for (std::size_t i = 0; i + apart < frames.size(); ++i, ++n) {
    const TimedCounter &from = frames[i], &to = frames[i + apart];
    const std::uint64_t wrap = to.counter < from.counter ? modulus : 0;
    const double time_s = std::max(to.time_s - from.time_s, 1e-9);  // a NaN must not get among the rates
    rates[n] = static_cast<double>(to.counter + wrap - from.counter) / time_s;
  }
  return if_possible(median(std::span(rates).first(n)));
}

std::optional<double> transmit_rate_hz(std::span<const double> times_s) {
  assert(times_s.size() >= 2 && times_s.size() <= kRateFrames);
  std::array<double, kRateFrames> gaps{};
  for (std::size_t i = 1; i < times_s.size(); ++i) gaps[i - 1] = times_s[i] - times_s[i - 1];
  const double gap_s = median(std::span(gaps).first(times_s.size() - 1));
  if (!if_possible(1 / gap_s)) return std::nullopt;
  double periods = 0, time_s = 0;
  for (std::size_t i = 1; i < times_s.size(); ++i) {
    const double step_s = times_s[i] - times_s[i - 1];
    if (step_s > kMaxGap * gap_s)
      continue;  // so long, the median's error is no longer small against a period
    periods += std::round(step_s / gap_s);
    time_s += step_s;
  }
  return if_possible(periods / time_s);
}

}  // namespace csipose
