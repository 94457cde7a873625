#include "model/background_meter.h"

#include <fmt/format.h>

#include <algorithm>
#include <cassert>
#include <cmath>

#include "proto/result.h"

namespace csipose {

void BackgroundMeter::add(std::span<const float> x) {
  assert(x.size() == kChannels * kTokens);
  constexpr std::size_t kMiddle = kSamples / 2;
  for (std::size_t e = 0; e < kElements; ++e) {
    const auto value = static_cast<double>(x[Window::index(e / kLinks, kMiddle, e % kLinks)]);
    first_[e] += e < kFirstPhase ? value : std::cos(value);
    second_[e] += e < kFirstPhase ? value * value : std::sin(value);
  }
  ++count_;
}

Background BackgroundMeter::background(const std::string& name) const {
  Background out{name, {}, {}};
  const auto count = static_cast<double>(std::max<std::uint64_t>(count_, 1));
  for (std::size_t e = 0; e < kElements; ++e) {
    const bool phase = e >= kFirstPhase;
    const double a = first_[e] / count, b = second_[e] / count;
    const double squares = phase ? -std::log(std::min(a * a + b * b, 1.)) : std::max(b - a * a, 0.);
    const auto deviation = static_cast<float>(std::sqrt(squares));
    if (!(deviation > 0) || !std::isfinite(deviation))
      throw SetupError(
          ExitStatus::bad_data,
          fmt::format("no background of {} can be had from {} windows: {} {} of link {} does not vary, or is "
                      "no number; take windows during which people move about",
                      name, count_, phase ? "phase" : "amplitude", e / kLinks % kSubcarriers, e % kLinks));
    out.mean[e] = static_cast<float>(phase ? std::atan2(b, a) : a);
    out.deviation[e] = deviation;
  }
  return out;
}

}  // namespace csipose
