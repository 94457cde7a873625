#include "capture/transmit_line.h"

#include <algorithm>
#include <cassert>
#include <cmath>

namespace csipose {

namespace {
// A frame this far off the line is no jitter: above the stalls of an ordinary host (3 to 25 ms in the made-up
// but realistic set that we test with) and above half a window, within which a jump of time would still look
// like motion.
constexpr double kMinTolerance_s = 0.030;
constexpr double kToleranceSlots = 10;
// A counter that was met so recently may come late from a slow receiver.
constexpr double kMaxLate_s = 2.0;
constexpr double kSlotClockBucket_s = 0.1;    // times LowerLine::kBuckets: the tick remembers some 3 s
constexpr double kSlotClockTolerance = 0.03;  // transmit rates within 2 % of the grid are taken for it
constexpr std::uint64_t kLargeCounter = std::uint64_t{1} << 62;
constexpr std::int64_t kFarAhead = std::int64_t{1} << 61;  // beyond it, differences of counters may wrap

LowerLine::Config slot_clock(double grid_hz, double slots_per_s) {
  return {.bucket = kSlotClockBucket_s * grid_hz,
          .slope = 1e9 / slots_per_s,
          .slope_tolerance = kSlotClockTolerance};
}

/// a - b where a may be any 64 bits that somebody sent.
std::int64_t distance(std::int64_t a, std::int64_t b) {
  return static_cast<std::int64_t>(static_cast<std::uint64_t>(a) - static_cast<std::uint64_t>(b));
}

/// The smallest value from `floor` on that is `value` modulo `modulus`.
std::int64_t congruent_from(std::int64_t floor, std::int64_t value, std::uint64_t modulus) {
  const auto m = static_cast<std::int64_t>(modulus);
  const std::int64_t ahead = (value - floor) % m;
  return floor + (ahead < 0 ? ahead + m : ahead);
}
}  // namespace

TransmitLine::TransmitLine(double grid_hz)
    : grid_hz_(grid_hz),
      tolerance_s_(std::max(kMinTolerance_s, kToleranceSlots / grid_hz)),
      slot_ns_(slot_clock(grid_hz, grid_hz)) {}

void TransmitLine::start(TxCounter first, double tx_hz, double measured_hz, SteadyTime on_air) {
  assert(!started() && tx_hz > 0 && measured_hz > 0);
  tx_hz_ = tx_hz;
  slot_ns_ = LowerLine(slot_clock(grid_hz_, grid_hz_ / tx_hz * measured_hz));
  // Numbers near the end of 64 bits are moved away from it, so that counters can be subtracted without care.
  now_.shift = first.value < kLargeCounter ? 0 : kLargeCounter - first.value;
  now_.first_counter = now_.anchor_counter = static_cast<std::int64_t>(first.value + now_.shift);
  before_ = now_;
  newest_ = now_.anchor_counter - 1;
  arrived(now_.anchor_counter, on_air);
}

std::optional<std::int64_t> TransmitLine::place(TxCounter raw, SteadyTime on_air) {
  assert(started());
  const Candidate here = nearest(raw, now_, on_air);
  if (fits(here) && here.counter >= now_.first_counter) return accept(here.counter);
  const Candidate earlier = nearest(raw, before_, on_air);
  if (fits(earlier) && earlier.counter < now_.first_counter) return accept(earlier.counter);

  const auto shifted = static_cast<std::int64_t>(raw.value + now_.shift);
  const std::int64_t next = raw.modulus == 0 ? shifted : congruent_from(newest_ + 1, shifted, raw.modulus);
  const std::int64_t ahead = distance(next, newest_);
  if (ahead > 0 && ahead < kFarAhead && late_s(next, now_, on_air) > tolerance_s_) {
    ++pauses_;
    return resume(next, now_.shift, on_air);
  }
  return dissent(raw, on_air);
}

std::optional<std::int64_t> TransmitLine::place_unwrapped(std::int64_t counter, SteadyTime on_air) {
  return place({static_cast<std::uint64_t>(counter) - now_.shift, 0}, on_air);
}

std::int64_t TransmitLine::fresh_counter(SteadyTime on_air) const {
  return std::max(newest_ + 1, expected(now_, on_air));
}

void TransmitLine::arrived(std::int64_t counter, SteadyTime arrival) {
  const Segment& segment = counter >= now_.first_counter ? now_ : before_;
  slot_ns_.add(position_of(counter, segment), static_cast<double>(ns(arrival)));
}

std::int64_t TransmitLine::slot_of(std::int64_t counter) const {
  const Segment& segment = counter >= now_.first_counter ? now_ : before_;
  return static_cast<std::int64_t>(std::floor(position_of(counter, segment)));
}

SteadyTime TransmitLine::time_of(std::int64_t slot) const {
  return SteadyTime{Nanoseconds{std::llround(slot_ns_.y_at(static_cast<double>(slot)))}};
}

std::int64_t TransmitLine::first_slot_from(SteadyTime time) const {
  constexpr double kRounding = 1e-5;  // slots: time_of() is whole nanoseconds
  return static_cast<std::int64_t>(std::ceil(position_at(time) - kRounding));
}

double TransmitLine::counter_period_s() const { return slot_ns_.slope() * 1e-9 * grid_hz_ / tx_hz_; }

double TransmitLine::position_of(std::int64_t counter, const Segment& segment) const {
  // The product is exact and the quotient rounded once: whole slots come out whole.
  const auto steps = static_cast<double>(distance(counter, segment.anchor_counter));
  return static_cast<double>(segment.anchor_slot) + steps * grid_hz_ / tx_hz_;
}

double TransmitLine::position_at(SteadyTime time) const {
  return slot_ns_.x_at(static_cast<double>(ns(time)));
}

double TransmitLine::late_s(std::int64_t counter, const Segment& segment, SteadyTime on_air) const {
  return (static_cast<double>(ns(on_air)) - slot_ns_.y_at(position_of(counter, segment))) * 1e-9;
}

std::int64_t TransmitLine::expected(const Segment& segment, SteadyTime on_air) const {
  const double slots = position_at(on_air) - static_cast<double>(segment.anchor_slot);
  return segment.anchor_counter + std::llround(slots * tx_hz_ / grid_hz_);
}

/// Of all counters that `raw` may stand for, the one nearest to what the line expects at that time.
TransmitLine::Candidate TransmitLine::nearest(TxCounter raw, const Segment& segment,
                                              SteadyTime on_air) const {
  auto counter = static_cast<std::int64_t>(raw.value + segment.shift);
  if (raw.modulus != 0)
    counter = congruent_from(expected(segment, on_air) - static_cast<std::int64_t>(raw.modulus / 2), counter,
                             raw.modulus);
  return {counter, late_s(counter, segment, on_air)};
}

bool TransmitLine::fits(const Candidate& candidate) const {
  if (std::abs(candidate.late_s) <= tolerance_s_) return true;
  return distance(candidate.counter, newest_) <= 0 && candidate.late_s > 0 && candidate.late_s < kMaxLate_s;
}

std::optional<std::int64_t> TransmitLine::accept(std::int64_t counter) {
  dissent_.frames = 0;
  newest_ = std::max(newest_, counter);
  newest_slot_ = std::max(newest_slot_, slot_of(counter));
  return counter;
}

/// Opens a segment whose slots go on by the time that passed. Rounded down: the tick may then be early, never
/// late.
std::optional<std::int64_t> TransmitLine::resume(std::int64_t counter, std::uint64_t shift,
                                                 SteadyTime on_air) {
  const auto slot = static_cast<std::int64_t>(std::floor(position_at(on_air)));
  before_ = now_;
  now_ = {newest_ + 1, counter, std::max(newest_slot_ + 1, slot), shift};
  slot_ns_.restart();  // what the line said before the silence is worth less than the first arrival after it
  arrived(counter, on_air);
  return accept(counter);
}

std::optional<std::int64_t> TransmitLine::dissent(TxCounter raw, SteadyTime on_air) {
  if (!continues_dissent(raw, on_air)) dissent_ = {0, raw, on_air};
  if (++dissent_.frames < kRestartFrames) return std::nullopt;
  ++restarts_;
  const std::int64_t counter = newest_ + 1;
  return resume(counter, static_cast<std::uint64_t>(counter) - raw.value, on_air);
}

bool TransmitLine::continues_dissent(TxCounter raw, SteadyTime on_air) const {
  if (dissent_.frames == 0 || raw.modulus != dissent_.first.modulus) return false;
  const std::uint64_t wrap = raw.value < dissent_.first.value ? raw.modulus : 0;  // 2^64 wraps by itself
  const auto counted = static_cast<double>(raw.value + wrap - dissent_.first.value);
  return std::abs(counted / tx_hz_ - seconds(on_air - dissent_.on_air)) <= tolerance_s_;
}

}  // namespace csipose
