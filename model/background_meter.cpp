#include "model/background_meter.h"

#include <fmt/format.h>

#include <algorithm>
#include <cassert>
#include <cmath>
#include <numbers>

#include "proto/result.h"

namespace csipose {
namespace {

constexpr std::size_t kMostKept = 4096;
constexpr int kRounds = 8;
/// Of the response's amplitude on a link: less is what arithmetic leaves of samples that are the same.
constexpr double kLeastVariation = 1e-4;
const LinkSet kAll = LinkSet().set();

/// Means and mean squares of the departures of all samples.
struct Departed {
  std::array<double, kElements> mean{}, square{};
};
Departed departed_from(const Background& background, std::span<const std::array<float, kElements>> samples) {
  Departed out;
  for (const auto& sample : samples) {
    const auto departure = departures(background, sample, kAll);
    for (std::size_t e = 0; e < kElements; ++e) {
      const auto value = static_cast<double>(departure[e]);
      out.mean[e] += value / static_cast<double>(samples.size());
      out.square[e] += value * value / static_cast<double>(samples.size());
    }
  }
  return out;
}

/// Mean power of each receiver's elements.
using Powers = std::array<double, kReceivers>;
void add_power(Powers& powers, const std::array<float, kElements>& sample, double weight) {
  for (std::size_t e = 0; e < kFirstPhase; ++e)
    powers[e % kLinks / kAntennas] += weight * std::pow(static_cast<double>(sample[e]), 2);
}

/// The response moved by the mean departure, which makes it weaker as well, and brought to these powers again.
void move(std::array<float, kElements>& response, const Departed& departed, const Powers& powers) {
  for (std::size_t e = 0; e < kFirstPhase; ++e) {
    const double in_phase = static_cast<double>(response[e]) + departed.mean[e],
                 across = departed.mean[kFirstPhase + e];
    response[e] = static_cast<float>(std::hypot(in_phase, across));
    const double phase = static_cast<double>(response[kFirstPhase + e]) + std::atan2(across, in_phase);
    response[kFirstPhase + e] = static_cast<float>(std::remainder(phase, 2 * std::numbers::pi));
  }
  Powers moved{};
  add_power(moved, response, 1);
  for (std::size_t e = 0; e < kFirstPhase; ++e) {
    const std::size_t receiver = e % kLinks / kAntennas;
    if (moved[receiver] > 0) response[e] *= static_cast<float>(std::sqrt(powers[receiver] / moved[receiver]));
  }
}

double mean_amplitude(const Background& background, std::size_t link) {
  double sum = 0;
  for (std::size_t n = 0; n < kSubcarriers; ++n)
    sum += static_cast<double>(background.response[n * kLinks + link]);
  return sum / kSubcarriers;
}

}  // namespace

void BackgroundMeter::add(std::span<const float> x) {
  assert(x.size() == kChannels * kTokens);
  if (count_++ % stride_ != 0) return;
  auto& sample = kept_.emplace_back();
  for (std::size_t e = 0; e < kElements; ++e)
    sample[e] = x[Window::index(e / kLinks, kSamples / 2, e % kLinks)];
  if (kept_.size() < kMostKept) return;
  for (std::size_t i = 0; i < kMostKept / 2; ++i) kept_[i] = kept_[2 * i];
  kept_.resize(kMostKept / 2);
  stride_ *= 2;
}

Background BackgroundMeter::background(const std::string& name) const {
  Background out{name, {}, {}};
  if (!kept_.empty()) out.response = kept_.front();
  Powers powers{};
  for (const auto& sample : kept_) add_power(powers, sample, 1 / static_cast<double>(kept_.size()));
  for (int i = 0; i < kRounds; ++i) move(out.response, departed_from(out, kept_), powers);
  const Departed departed = departed_from(out, kept_);
  for (std::size_t e = 0; e < kElements; ++e) {
    const double deviation = std::sqrt(departed.square[e]);
    if (!(deviation > kLeastVariation * mean_amplitude(out, e % kLinks)) || !std::isfinite(deviation))
      throw SetupError(
          ExitStatus::bad_data,
          fmt::format(
              "no background of {} can be had from {} windows: subcarrier {} of link {} does not vary, or is "
              "no number; take windows during which people move about",
              name, count_, e / kLinks % kSubcarriers, e % kLinks));
    out.deviation[e] = static_cast<float>(deviation);
  }
  return out;
}

}  // namespace csipose
