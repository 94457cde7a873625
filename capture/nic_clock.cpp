#include "capture/nic_clock.h"

#include <cmath>

namespace csipose {

namespace {
constexpr std::int64_t kWrapUs = std::int64_t{1} << 32;
constexpr std::int64_t kStepUs =
    1'000'000;                     // further than this from what the arrivals say: the clock was set
constexpr int kFrozenRecords = 8;  // as many equal timestamps: no clock (the csitool sample always says 4)
// Both oscillators within +-20 ppm (802.11n-2009, 20.3.21.4); a second collects 300 arrivals to find a short
// path in.
constexpr LowerLine::Config kHostLine{.bucket = 1e6, .slope = 1e3, .slope_tolerance = 40e-6};
}  // namespace

NicClock::NicClock() : host_ns_(kHostLine) {}

NicClock::Reading NicClock::read(std::uint32_t timestamp_low, bool in_order, SteadyTime arrival) {
  const bool frozen = started_ && timestamp_low == last_low_;
  const bool was_frozen = !usable();
  unchanged_ = frozen ? unchanged_ + 1 : 0;
  if (!started_) {
    begin_epoch(timestamp_low);
  } else if (!frozen) {
    const std::int64_t expected_us = ns(arrival - last_arrival_) / 1000;
    const std::int64_t step_us = step_nearest(timestamp_low, expected_us);
    if (was_frozen || std::abs(step_us - expected_us) > kStepUs || (step_us < 0 && in_order)) {
      ++epoch_;
      begin_epoch(timestamp_low);
    } else {
      us_ += step_us;
      moved_ = true;
    }
  }
  started_ = true;
  last_low_ = timestamp_low;
  last_arrival_ = arrival;
  if (!frozen) host_ns_.add(static_cast<double>(us_), static_cast<double>(ns(arrival)));
  return {us_, epoch_, usable()};
}

bool NicClock::usable() const { return unchanged_ < kFrozenRecords - 1; }

SteadyTime NicClock::on_air(const Reading& reading, SteadyTime arrival) const {
  if (!moved_ || !reading.usable) return arrival;  // one reading, or a frozen clock: no line yet
  return SteadyTime{Nanoseconds{std::llround(host_ns_.y_at(static_cast<double>(reading.us)))}};
}

void NicClock::begin_epoch(std::uint32_t timestamp_low) {
  us_ = timestamp_low;
  moved_ = false;
  host_ns_.restart();
}

/// The step since the last record, modulo the wrap, that lies nearest to what the arrivals say.
std::int64_t NicClock::step_nearest(std::uint32_t timestamp_low, std::int64_t expected_us) const {
  const auto step_us = static_cast<std::int64_t>(timestamp_low) - static_cast<std::int64_t>(last_low_);
  const double wraps = static_cast<double>(expected_us - step_us) / static_cast<double>(kWrapUs);
  return step_us + std::llround(wraps) * kWrapUs;
}

}  // namespace csipose
