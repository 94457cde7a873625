#include "capture/window_builder.h"

#include <algorithm>
#include <bit>
#include <cassert>
#include <cmath>

namespace csipose {

namespace {
constexpr double kRemembered_s = 2;

std::size_t ring_size(double grid_hz, int max_gap) {
  const auto window = static_cast<std::size_t>(max_gap) + kSamples;
  return std::bit_ceil(std::max(static_cast<std::size_t>(kRemembered_s * grid_hz), 2 * window));
}

void write_sample(const Features& features, std::size_t t, std::size_t receiver, Window& window) {
  for (std::size_t c = 0; c < kChannels; ++c)
    for (std::size_t a = 0; a < kAntennas; ++a)
      window.x[Window::index(c, t, receiver * kAntennas + a)] = features[c * kAntennas + a];
}
}  // namespace

WindowBuilder::WindowBuilder(const Config& config)
    : config_(config), mask_(ring_size(config.grid_hz, config.max_gap) - 1) {
  for (auto& ring : ring_) ring.resize(mask_ + 1);
}

bool WindowBuilder::put(std::uint8_t receiver, const Sample& sample) {
  Sample& cell = ring_[receiver][static_cast<std::size_t>(sample.slot) & mask_];
  if (cell.slot > sample.slot || (cell.slot == sample.slot && cell.counter >= sample.counter)) return false;
  cell = sample;
  return true;
}

void WindowBuilder::assemble(std::int64_t end_slot, Window& window) const {
  window.x.fill(0);
  window.reasons = 0;
  window.links.reset();
  window.end_slot = end_slot;
  const bool is_40mhz = majority_is_40mhz(end_slot, window);
  for (std::uint8_t r = 0; r < kReceivers; ++r) assemble_receiver(r, end_slot, is_40mhz, window);
  judge_skew(end_slot, window);
}

const Sample* WindowBuilder::find(std::uint8_t receiver, std::int64_t slot) const {
  const Sample& cell = ring_[receiver][static_cast<std::size_t>(slot) & mask_];
  return cell.slot == slot ? &cell : nullptr;
}

/// The width of most samples; the newest decides a draw.
bool WindowBuilder::majority_is_40mhz(std::int64_t end_slot, Window& window) const {
  int wide = 0, narrow = 0;
  bool newest_is_40mhz = false;
  for (std::int64_t slot = end_slot - std::int64_t{kSamples} + 1; slot <= end_slot; ++slot)
    for (std::uint8_t r = 0; r < kReceivers; ++r)
      if (const Sample* sample = find(r, slot)) {
        ++(sample->is_40mhz ? wide : narrow);
        newest_is_40mhz = sample->is_40mhz;
      }
  if (wide > 0 && narrow > 0) window.reasons |= kMixedWidth;
  return wide == narrow ? newest_is_40mhz : wide > narrow;
}

WindowBuilder::Choice WindowBuilder::choose(std::uint8_t receiver, std::int64_t slot, bool is_40mhz,
                                            Window& window) const {
  for (int back = 0; back <= config_.max_gap; ++back) {
    const Sample* sample = find(receiver, slot - back);
    if (sample == nullptr || sample->is_40mhz != is_40mhz) continue;
    if (sample->finite) return {sample, back == 0 ? SampleState::received : SampleState::filled};
    window.reasons |= kNotFinite;
  }
  return {};
}

void WindowBuilder::assemble_receiver(std::uint8_t receiver, std::int64_t end_slot, bool is_40mhz,
                                      Window& window) const {
  std::array<Choice, kSamples> choices;
  std::size_t received = 0, missing = 0;
  std::array<double, kAntennas> rssi_sum{}, rssi_count{};
  ReceiverQuality& quality = window.receivers[receiver];
  quality.last_counter = 0;
  for (std::size_t t = 0; t < kSamples; ++t) {
    choices[t] = choose(receiver, end_slot + 1 - static_cast<std::int64_t>(kSamples - t), is_40mhz, window);
    window.samples[t][receiver] = choices[t].state;
    if (choices[t].state == SampleState::missing) ++missing;
    if (choices[t].state != SampleState::received) continue;
    ++received;
    quality.last_counter = static_cast<std::uint64_t>(choices[t].sample->counter);
    for (std::size_t a = 0; a < kAntennas; ++a) {
      const float rssi_dbm = choices[t].sample->rssi_dbm[a];
      if (!std::isnan(rssi_dbm)) rssi_sum[a] += rssi_dbm, ++rssi_count[a];
    }
  }
  for (std::size_t a = 0; a < kAntennas; ++a)
    quality.rssi_dbm[a] = static_cast<float>(rssi_sum[a] / rssi_count[a]);  // 0 / 0 is NaN, as it should be
  quality.missing_ratio = 1 - static_cast<float>(received) / kSamples;
  if (received < kSamples) window.reasons |= kGap;
  if (missing > 0) {
    window.reasons |= kReceiverMissing;
    return;
  }
  for (std::size_t t = 0; t < kSamples; ++t) write_sample(choices[t].sample->features, t, receiver, window);
  for (std::size_t a = 0; a < kAntennas; ++a) window.links.set(receiver * kAntennas + a);
}

void WindowBuilder::judge_skew(std::int64_t end_slot, Window& window) const {
  for (std::int64_t slot = end_slot - std::int64_t{kSamples} + 1; slot <= end_slot; ++slot) {
    SteadyTime first = SteadyTime::max(), last = SteadyTime::min();
    for (std::uint8_t r = 0; r < kReceivers; ++r)
      if (const Sample* sample = find(r, slot)) {
        first = std::min(first, sample->on_air);
        last = std::max(last, sample->on_air);
      }
    if (first < last && last - first > config_.max_skew) window.reasons |= kSkew;
  }
}

}  // namespace csipose
