#include "capture/aligner.h"

#include <algorithm>
#include <cassert>
#include <cmath>
#include <limits>

namespace csipose {

namespace {
constexpr double kUnknown_us = std::numeric_limits<double>::quiet_NaN();
constexpr Nanoseconds kEventLife = std::chrono::seconds(1);
constexpr Nanoseconds kReferenceSilence = std::chrono::seconds(1);
// A crystal that warms up moves by a tenth of a ppm a second: after 2 s the line is still good to a
// microsecond.
constexpr Nanoseconds kMaxSilence = std::chrono::seconds(2);
constexpr int kMaxAlone = 32;
constexpr int kMinMatches = 8;
constexpr double kMinTolerance_us =
    50;  // timestamps are whole microseconds; their jitter was measured below 2

std::uint8_t bit(std::size_t receiver) { return static_cast<std::uint8_t>(1U << receiver); }
double us(Nanoseconds d) { return static_cast<double>(d.count()) * 1e-3; }
}  // namespace

Aligner::Aligner(Nanoseconds max_error)
    : max_error_us_(us(max_error)), events_(kEvents), retired_(std::numeric_limits<std::int64_t>::min()) {
  axis_us_.reserve(kEvents);
}

bool Aligner::heard(const Frame& frame, std::int64_t counter) {
  expire(frame.arrival - kEventLife);
  Event* event = event_of(counter, frame.arrival);
  if (event == nullptr) return true;  // of long ago: nobody remembers
  if ((event->heard & bit(frame.receiver)) != 0) return false;
  event->heard |= bit(frame.receiver);
  event->nic[frame.receiver] = frame.nic;
  follow_epoch(frame);
  if (!frame.nic.usable) return true;
  choose_reference(frame);
  time_event(*event, frame);
  Clock& clock = clocks_[frame.receiver];
  clock.last = frame.nic;
  clock.last_on_air = frame.on_air;
  clock.last_arrival = frame.arrival;
  return true;
}

bool Aligner::settled(const Frame& frame) const {
  const Clock& clock = clocks_[frame.receiver];
  return clock.line.anchored() && clock.epoch == frame.nic.epoch &&
         frame.arrival - clock.last_arrival < kMaxSilence;
}

void Aligner::settle(std::span<const Frame> frames, double period_s) {
  assert(!frames.empty());
  const Frame& last = frames.back();
  Clock& clock = clocks_[last.receiver];
  clock.line.reset();
  clock.epoch = last.nic.epoch;
  clock.last_arrival = last.arrival;
  clock.last_on_air = last.on_air;
  clock.last = last.nic;
  const std::optional<double> coarse_us = coarse_axis_us(last);
  if (!coarse_us) return start_axis(frames.front());
  double offset_us = *coarse_us - static_cast<double>(last.nic.us);
  if (const auto shift = best_shift(frames, offset_us, period_s * 1e6)) offset_us = shift->offset_us;
  clock.line.anchor(last.nic.us, static_cast<double>(last.nic.us) + offset_us);
}

std::optional<std::int64_t> Aligner::counter_by_time(const Frame& frame, double period_s) const {
  const double axis_us = clocks_[frame.receiver].line.axis_at(frame.nic.us);
  const Event *before = nullptr, *after = nullptr;
  for (std::size_t i = count_; i-- > 0 && before == nullptr;)
    if (at(i).axis_us <= axis_us)
      before = &at(i);
    else if (at(i).axis_us > axis_us)
      after = &at(i);

  const double to_before = before ? axis_us - before->axis_us : std::numeric_limits<double>::infinity();
  const double to_after = after ? after->axis_us - axis_us : std::numeric_limits<double>::infinity();
  const Event* nearest = to_before <= to_after ? before : after;
  if (nearest == nullptr) return std::nullopt;
  if (std::min(to_before, to_after) <= tolerance_us(frame.receiver, period_s * 1e6)) return nearest->counter;

  const auto steps = [&](double distance_us) {
    return std::max<std::int64_t>(1, std::llround(distance_us * 1e-6 / period_s));
  };
  const std::int64_t counter = before ? before->counter + steps(to_before) : after->counter - steps(to_after);
  if (after == nullptr || counter < after->counter) return counter;
  return after->counter - 1 > before->counter ? std::optional(after->counter - 1) : std::nullopt;
}

Aligner::ReceiverView Aligner::view(std::uint8_t receiver) const {
  const Clock& clock = clocks_[receiver];
  ReceiverView view{kUnknown_us, kUnknown_us, kUnknown_us, clock.heard, clock.matched, clock.missed};
  if (!clock.line.anchored()) return view;
  view.offset_s = (static_cast<double>(clock.last.us) - clock.line.axis_at(clock.last.us)) * 1e-6;
  view.skew_ppm = clock.line.skew() * 1e6;
  view.residual_s = clock.line.residual_us() * 1e-6;
  return view;
}

void Aligner::finish() {
  for (; count_ > 0; --count_, first_ = (first_ + 1) % kEvents) retire(at(0));
}

/// The event with this counter, made where there is none; nullptr for one that lies behind the last second.
Aligner::Event* Aligner::event_of(std::int64_t counter, SteadyTime arrival) {
  std::size_t i = count_;
  while (i > 0 && at(i - 1).counter > counter) --i;
  if (i > 0 && at(i - 1).counter == counter) return &at(i - 1);
  if (counter <= retired_) return nullptr;
  if (count_ == kEvents) {
    if (i == 0) return nullptr;
    retire(at(0));
    first_ = (first_ + 1) % kEvents, --count_, --i;
  }
  for (std::size_t j = count_++; j > i; --j) at(j) = at(j - 1);
  at(i) = Event{.counter = counter, .axis_us = kUnknown_us, .arrival = arrival};
  return &at(i);
}

void Aligner::follow_epoch(const Frame& frame) {
  Clock& clock = clocks_[frame.receiver];
  if (clock.epoch == frame.nic.epoch && frame.nic.usable) return;
  clock.epoch = frame.nic.epoch;
  clock.line.reset();
  if (reference_ == frame.receiver) reference_ = kNobody;
}

/// The reference stays as long as it is heard: then the axis is one clock's, without seams.
void Aligner::choose_reference(const Frame& frame) {
  if (reference_ == frame.receiver) return;
  const bool alive =
      reference_ != kNobody && frame.arrival - clocks_[reference_].last_arrival <= kReferenceSilence;
  if (alive) return;
  if (clocks_[frame.receiver].line.anchored())
    reference_ = frame.receiver;
  else if (!coarse_axis_us(frame))
    start_axis(frame);
}

void Aligner::start_axis(const Frame& frame) {
  for (Clock& clock : clocks_) clock.line.reset();
  for (std::size_t i = 0; i < count_; ++i) {
    at(i).axis_us = kUnknown_us;
    at(i).by_reference = false;
  }
  reference_ = frame.receiver;
  clocks_[reference_].line.anchor(frame.nic.us, static_cast<double>(frame.nic.us));
}

void Aligner::time_event(Event& event, const Frame& frame) {
  const PairLine& line = clocks_[frame.receiver].line;
  if (frame.receiver == reference_) {
    event.axis_us = line.axis_at(frame.nic.us);
    event.by_reference = true;
    for (std::uint8_t r = 0; r < kReceivers; ++r)
      if (r != reference_ && (event.heard & bit(r)) != 0) pair(r, event);
  } else if (event.by_reference) {
    pair(frame.receiver, event);
  } else if (std::isnan(event.axis_us) && line.anchored()) {
    event.axis_us = line.axis_at(frame.nic.us);
  }
}

void Aligner::pair(std::uint8_t receiver, const Event& event) {
  Clock& clock = clocks_[receiver];
  const NicClock::Reading& nic = event.nic[receiver];
  if (!nic.usable || nic.epoch != clock.epoch) return;
  if (!clock.line.anchored()) clock.line.anchor(nic.us, event.axis_us);
  if (!clock.line.add(nic.us, event.axis_us)) clock.line.reset();
}

/// The frame's time on the axis by way of the clock of arrivals: off by the difference of two shortest paths.
/// nullopt when no other receiver that was heard lately is on the axis.
std::optional<double> Aligner::coarse_axis_us(const Frame& frame) const {
  const Clock* via = nullptr;
  for (std::uint8_t r = 0; r < kReceivers; ++r) {
    const Clock& clock = clocks_[r];
    const bool fit =
        r != frame.receiver && clock.line.anchored() && frame.arrival - clock.last_arrival < kMaxSilence;
    if (fit && (via == nullptr || r == reference_)) via = &clock;
  }
  if (via == nullptr) return std::nullopt;
  return via->line.axis_at(via->last.us) + us(frame.on_air - via->last_on_air);
}

double Aligner::tolerance_us(std::uint8_t receiver, double period_us) const {
  double tolerance = 0;
  for (std::uint8_t r = 0; r < kReceivers; ++r) {
    const PairLine& line = clocks_[r].line;
    const bool concerned =
        r == receiver || receiver == reference_;  // the reference meets what others have placed
    if (concerned && line.pairs() >= PairLine::kMinPairs)
      tolerance = std::max(tolerance, 6 * line.residual_us());
  }
  if (tolerance == 0) return period_us / 2;
  return std::min(std::max(tolerance, kMinTolerance_us), period_us / 2);
}

/// The irregular gaps of the frames laid over those of the events: at the right shift the differences are a
/// straight line to a microsecond, at any other they show the jitter of channel access twice. Without jitter
/// all shifts look alike, and the coarse guess decides.
std::optional<Aligner::Shift> Aligner::best_shift(std::span<const Frame> frames, double coarse_us,
                                                  double period_us) {
  axis_us_.clear();
  for (std::size_t i = 0; i < count_; ++i)
    if (!std::isnan(at(i).axis_us)) axis_us_.push_back(at(i).axis_us);
  std::sort(axis_us_.begin(), axis_us_.end());

  std::optional<Shift> best;
  const auto better = [&](const Shift& a, const Shift& b) {
    if (5 * a.matches < 4 * b.matches || 5 * b.matches < 4 * a.matches) return a.matches > b.matches;
    const double good_us = 2 * std::min(a.spread_us, b.spread_us) + 2;
    if (a.spread_us > good_us || b.spread_us > good_us) return a.spread_us < b.spread_us;
    return std::abs(a.offset_us - coarse_us) < std::abs(b.offset_us - coarse_us);
  };
  for (const std::size_t quarter : {1, 2, 3}) {  // three frames try, in case others have lost one
    const double frame_us = static_cast<double>(frames[frames.size() * quarter / 4].nic.us);
    const double from_us = frame_us + coarse_us - max_error_us_, to_us = frame_us + coarse_us + max_error_us_;
    for (auto e = std::lower_bound(axis_us_.begin(), axis_us_.end(), from_us);
         e != axis_us_.end() && *e <= to_us; ++e) {
      const Shift shift = judge(frames, *e - frame_us, period_us / 4);
      if (shift.matches >= kMinMatches && (!best || better(shift, *best))) best = shift;
    }
  }
  return best;
}

/// How well frames moved by an offset meet events: matches, their mean offset, and their spread about a
/// straight line.
Aligner::Shift Aligner::judge(std::span<const Frame> frames, double offset_us, double tolerance_us) const {
  double n = 0, sx = 0, sy = 0, sxx = 0, sxy = 0, syy = 0;
  for (const Frame& frame : frames) {
    const double x = static_cast<double>(frame.nic.us - frames.front().nic.us);
    const double moved_us = static_cast<double>(frame.nic.us) + offset_us;
    auto e = std::lower_bound(axis_us_.begin(), axis_us_.end(), moved_us);
    if (e == axis_us_.end() || (e != axis_us_.begin() && moved_us - *(e - 1) < *e - moved_us)) --e;
    const double y = *e - moved_us;
    if (std::abs(y) > tolerance_us) continue;
    n += 1, sx += x, sy += y, sxx += x * x, sxy += x * y, syy += y * y;
  }
  if (n < 2) return {offset_us, std::numeric_limits<double>::infinity(), 0};
  const double vxx = sxx - sx * sx / n, vxy = sxy - sx * sy / n, vyy = syy - sy * sy / n;
  const double left = std::max(0.0, vxx > 0 ? vyy - vxy * vxy / vxx : vyy);
  return {offset_us + sy / n, std::sqrt(left / n), static_cast<int>(n)};
}

void Aligner::expire(SteadyTime before) {
  for (; count_ > 0 && at(0).arrival < before; --count_, first_ = (first_ + 1) % kEvents) retire(at(0));
}

void Aligner::retire(const Event& event) {
  retired_ = std::max(retired_, event.counter);
  for (std::uint8_t r = 0; r < kReceivers; ++r) {
    Clock& clock = clocks_[r];
    const bool here = (event.heard & bit(r)) != 0, elsewhere = (event.heard & ~bit(r)) != 0;
    clock.heard += here;
    clock.matched += here && elsewhere;
    clock.missed += !here;
    const bool reference_alive = reference_ != kNobody && reference_ != r &&
                                 clocks_[reference_].last_arrival - event.arrival > Nanoseconds{0};
    if (here && elsewhere) clock.alone = 0;
    if (here && !elsewhere && reference_alive && ++clock.alone == kMaxAlone) {
      clock.alone = 0;
      clock.line.reset();  // it must have been wrong: settle again
    }
  }
}

}  // namespace csipose
