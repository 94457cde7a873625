#include "capture/front_end.h"

#include <algorithm>
#include <cassert>
#include <cmath>
#include <vector>

#include "capture/aligner.h"
#include "capture/receiver_input.h"
#include "capture/transmit_line.h"
#include "capture/transmit_rate.h"
#include "capture/window_builder.h"

namespace csipose {

namespace {
constexpr double kSnap = 0.02;             // a transmit rate this near to the grid's is meant to be it
constexpr double kMaxArrivalClockHz = 50;  // above, queues blur arrivals by more than half a period
constexpr std::size_t kMaxHeld = 64;       // per receiver
constexpr double kMinHeld_s = 2;
constexpr std::uint32_t kArrivalEpoch = 0xFFFF'FFFF;          // of frames whose clock is their arrival
constexpr std::int64_t kEndOfTimeNs = std::int64_t{1} << 61;  // 73 years: leaves room for sums

std::int64_t bounded(std::int64_t time_ns) { return std::clamp<std::int64_t>(time_ns, 0, kEndOfTimeNs); }

enum class Placing {
  done,     ///< placed, or refused for good and counted
  not_yet,  ///< its receiver has to settle first
};
}  // namespace

/// Frames that cannot be placed yet, in the order of their arrival. Its memory is made once.
class HeldFrames {
 public:
  HeldFrames() { frames_.reserve(kReceivers * kMaxHeld); }
  bool empty() const { return frames_.empty(); }
  std::size_t count(std::uint8_t receiver) const {
    return static_cast<std::size_t>(std::count_if(
        frames_.begin(), frames_.end(), [&](const auto& f) { return f.time.receiver == receiver; }));
  }
  /// Requires count(receiver) < kMaxHeld.
  void push(const ReceivedFrame& frame) { frames_.push_back(frame); }
  void drop_oldest(std::uint8_t receiver) {
    frames_.erase(std::find_if(frames_.begin(), frames_.end(),
                               [&](const auto& f) { return f.time.receiver == receiver; }));
  }
  template <class Predicate>
  void remove_if(Predicate predicate) {
    std::erase_if(frames_, predicate);
  }
  auto begin() const { return frames_.begin(); }
  auto end() const { return frames_.end(); }

 private:
  std::vector<ReceivedFrame> frames_;
};

struct FrontEnd::State {
  explicit State(const FrontEndConfig& c)
      : config(c),
        inputs{ReceiverInput(0, c, stats.receivers[0]), ReceiverInput(1, c, stats.receivers[1]),
               ReceiverInput(2, c, stats.receivers[2])},
        line(c.grid_hz),
        aligner(c.max_skew),
        builder({c.grid_hz, c.max_gap, c.max_skew}) {}

  void add(const Packet& packet);
  void receive(const ReceivedFrame& frame);
  void hold(const ReceivedFrame& frame);
  void place_held();
  Placing place(const ReceivedFrame& frame);
  Placing place_by_time(const ReceivedFrame& frame);
  bool give_up(const ReceivedFrame& frame);
  void keep(const ReceivedFrame& frame, const Aligner::Frame& time, std::int64_t counter);

  bool counts(const ReceivedFrame& frame) const {
    return frame.counter && config.align == AlignMethod::tx_counter;
  }
  std::optional<Aligner::Frame> clocked(const ReceivedFrame& frame) const;
  std::size_t gather_by_time(std::uint8_t receiver);
  void settle_if_ready(std::uint8_t receiver);
  bool start_line();
  bool start_by_counter(const ReceivedFrame& first);
  bool start_by_time();
  std::optional<double> measured_by_counter() const;
  double grid_rate(double measured_hz) const;

  WindowDue due() const;
  void take(Window& window);
  std::uint64_t skip_before(SteadyTime time);
  void refresh(std::uint8_t receiver, SteadyTime now);

  FrontEndConfig config;
  FrontEndStats stats;
  std::array<ReceiverInput, kReceivers> inputs;
  TransmitLine line;
  Aligner aligner;
  WindowBuilder builder;
  HeldFrames held;
  ReceivedFrame in_hand;
  std::array<Aligner::Frame, kMaxHeld> by_time;  // scratch of gather_by_time()
  SteadyTime newest_arrival{};
  Nanoseconds utc_offset{};  // UTC less steady time, by the newest packet
  std::int64_t end_slot = static_cast<std::int64_t>(kSamples) - 1;
  SteadyTime last_due{};
};

FrontEnd::FrontEnd(const FrontEndConfig& config) : state_(std::make_unique<State>(config)) {
  assert(config.grid_hz > 0 && config.hop > 0 && config.max_gap >= 0 && config.tx_hz >= 0);
}
FrontEnd::~FrontEnd() = default;

void FrontEnd::add(const Packet& packet) { state_->add(packet); }
std::optional<WindowDue> FrontEnd::next() const {
  return state_->line.started() ? std::optional(state_->due()) : std::nullopt;
}
void FrontEnd::take(Window& window) { state_->take(window); }
std::uint64_t FrontEnd::skip_before(SteadyTime time) { return state_->skip_before(time); }
std::int64_t FrontEnd::newest_slot() const { return state_->line.newest_slot(); }
const FrontEndStats& FrontEnd::stats() const { return state_->stats; }

void FrontEnd::finish() {
  state_->aligner.finish();
  for (std::uint8_t r = 0; r < kReceivers; ++r) state_->refresh(r, state_->newest_arrival);
}

void FrontEnd::State::add(const Packet& packet) {
  assert(packet.receiver < kReceivers);
  newest_arrival = std::max(newest_arrival, SteadyTime{Nanoseconds{bounded(ns(packet.arrival))}});
  utc_offset = Nanoseconds{bounded(ns(packet.arrival_utc)) - ns(newest_arrival)};
  ReceiverInput& input = inputs[packet.receiver];
  input.begin(packet.records, newest_arrival);
  while (input.next(in_hand)) receive(in_hand);
  refresh(packet.receiver, newest_arrival);
}

void FrontEnd::State::receive(const ReceivedFrame& received) {
  if (held.empty() && line.started() && place(received) == Placing::done) return;
  hold(received);
  place_held();
}

void FrontEnd::State::hold(const ReceivedFrame& received) {
  const std::uint8_t receiver = received.time.receiver;
  if (held.count(receiver) == kMaxHeld) {
    held.drop_oldest(receiver);
    ++stats.receivers[receiver].no_counter;
  }
  held.push(received);
}

void FrontEnd::State::place_held() {
  if (!line.started() && !start_line()) return;
  held.remove_if([this](const ReceivedFrame& f) { return counts(f) && place(f) == Placing::done; });
  for (std::uint8_t r = 0; r < kReceivers;
       ++r) {  // one after the other: the next settles on what this one has placed
    settle_if_ready(r);
    held.remove_if([&](const ReceivedFrame& f) { return f.time.receiver == r && place(f) == Placing::done; });
  }
}

Placing FrontEnd::State::place(const ReceivedFrame& received) {
  if (!counts(received)) return place_by_time(received);
  if (const auto counter = line.place(*received.counter, received.time.on_air))
    keep(received, received.time, *counter);
  else
    ++stats.receivers[received.time.receiver].unplaced;
  return Placing::done;
}

Placing FrontEnd::State::place_by_time(const ReceivedFrame& received) {
  ReceiverStats& counters = stats.receivers[received.time.receiver];
  const std::optional<Aligner::Frame> time = clocked(received);
  if (!time) {
    ++counters.no_counter;
    return Placing::done;
  }
  if (!aligner.settled(*time)) return give_up(received) ? Placing::done : Placing::not_yet;
  const auto guess = aligner.counter_by_time(*time, line.counter_period_s());
  const auto counter = line.place_unwrapped(guess.value_or(line.fresh_counter(time->on_air)), time->on_air);
  if (counter)
    keep(received, *time, *counter);
  else
    ++counters.unplaced;
  return Placing::done;
}

/// A receiver that has not settled within twice the frames it needs will not do so on this one.
bool FrontEnd::State::give_up(const ReceivedFrame& received) {
  const double age_s = seconds(newest_arrival - received.time.arrival);
  const bool old = age_s > std::max(kMinHeld_s, kMaxHeld * line.counter_period_s());
  stats.receivers[received.time.receiver].no_counter += old;
  return old;
}

void FrontEnd::State::keep(const ReceivedFrame& received, const Aligner::Frame& time, std::int64_t counter) {
  ReceiverStats& counters = stats.receivers[time.receiver];
  if (!aligner.heard(time, counter)) {
    counters.duplicates += !received.repeated;
    return;
  }
  line.arrived(counter, time.arrival);
  Sample sample = received.sample;
  sample.counter = counter;
  sample.slot = line.slot_of(counter);
  if (stats.windows > 0 && sample.slot <= end_slot - config.hop) ++counters.late;
  builder.put(time.receiver, sample);
}

/// The frame with a clock to place it by: the receiver's own, or the arrival where that is fine enough;
/// nullopt when there is none, or when the receiver's clock has been set since.
std::optional<Aligner::Frame> FrontEnd::State::clocked(const ReceivedFrame& received) const {
  Aligner::Frame time = received.time;
  const NicClock& clock = inputs[time.receiver].clock();
  if (clock.usable()) return time.nic.epoch == clock.epoch() ? std::optional(time) : std::nullopt;
  const double hz = line.started() ? line.tx_hz() : config.tx_hz;
  if (hz > kMaxArrivalClockHz) return std::nullopt;
  time.nic = {ns(time.arrival) / 1000, kArrivalEpoch, true};
  time.on_air = time.arrival;
  return time;
}

/// The held frames of a receiver that go by time, ascending, into `by_time`; returns how many.
std::size_t FrontEnd::State::gather_by_time(std::uint8_t receiver) {
  std::size_t n = 0;
  for (const ReceivedFrame& f : held) {
    if (f.time.receiver != receiver || counts(f)) continue;
    if (const auto time = clocked(f)) by_time[n++] = *time;
  }
  std::sort(by_time.begin(), by_time.begin() + static_cast<std::ptrdiff_t>(n),
            [](const auto& a, const auto& b) { return a.nic.us < b.nic.us; });
  return n;
}

void FrontEnd::State::settle_if_ready(std::uint8_t receiver) {
  const std::size_t n = gather_by_time(receiver);
  if (n >= Aligner::kSettleFrames && !aligner.settled(by_time[n - 1]))
    aligner.settle(std::span(by_time).first(n), line.counter_period_s());
}

bool FrontEnd::State::start_line() {
  const auto first = std::find_if(held.begin(), held.end(), [this](const auto& f) { return counts(f); });
  return first != held.end() ? start_by_counter(*first) : start_by_time();
}

bool FrontEnd::State::start_by_counter(const ReceivedFrame& first) {
  const auto measured_hz = config.tx_hz > 0 ? std::optional(config.tx_hz) : measured_by_counter();
  if (!measured_hz) return false;
  line.start(*first.counter, grid_rate(*measured_hz), *measured_hz, first.time.on_air);
  stats.tx_hz = line.tx_hz();
  return true;
}

/// Without any counter the first receiver with enough frames starts the line; the numbers are our own.
bool FrontEnd::State::start_by_time() {
  for (std::uint8_t r = 0; r < kReceivers; ++r) {
    const std::size_t n = gather_by_time(r);
    if (n < kRateFrames) continue;
    std::array<double, kRateFrames> times_s;
    for (std::size_t i = 0; i < kRateFrames; ++i)
      times_s[i] = static_cast<double>(by_time[n - kRateFrames + i].nic.us) * 1e-6;
    const auto measured_hz = config.tx_hz > 0 ? std::optional(config.tx_hz) : transmit_rate_hz(times_s);
    if (!measured_hz) continue;
    line.start({}, grid_rate(*measured_hz), *measured_hz, by_time[0].on_air);
    stats.tx_hz = line.tx_hz();
    return true;
  }
  return false;
}

std::optional<double> FrontEnd::State::measured_by_counter() const {
  for (std::uint8_t r = 0; r < kReceivers; ++r) {
    std::array<TimedCounter, kRateFrames> frames;
    std::size_t n = 0;
    std::uint64_t modulus = 0;
    for (const ReceivedFrame& f : held) {
      if (f.time.receiver != r || !counts(f) || n == kRateFrames) continue;
      const auto time = clocked(f);
      frames[n++] = {
          time ? static_cast<double>(time->nic.us) * 1e-6 : seconds(f.time.arrival.time_since_epoch()),
          f.counter->value};
      modulus = f.counter->modulus;
    }
    if (n < kRateFrames) continue;
    if (const auto hz = transmit_rate_hz(frames, modulus)) return hz;
  }
  return std::nullopt;
}

double FrontEnd::State::grid_rate(double measured_hz) const {
  if (config.tx_hz > 0) return config.tx_hz;
  return std::abs(measured_hz / config.grid_hz - 1) <= kSnap ? config.grid_hz : measured_hz;
}

/// The tick follows the transmitter, but it never runs back: half a hop is the least between two windows.
WindowDue FrontEnd::State::due() const {
  const Nanoseconds least = from_seconds(0.5 * config.hop / config.grid_hz);
  return {end_slot, std::max(line.time_of(end_slot), stats.windows > 0 ? last_due + least : SteadyTime{})};
}

void FrontEnd::State::take(Window& window) {
  assert(line.started());
  const WindowDue next = due();
  builder.assemble(next.end_slot, window);
  window.last_sample = next.last_sample;
  window.last_sample_utc = UtcTime{next.last_sample.time_since_epoch() + utc_offset};
  window.first_sample_utc = window.last_sample_utc - from_seconds((kSamples - 1) / config.grid_hz);
  for (std::uint8_t r = 0; r < kReceivers; ++r) {
    refresh(r, std::max(newest_arrival, next.last_sample));
    window.receivers[r].rate_hz = static_cast<float>(stats.receivers[r].rate_hz);
    for (std::size_t t = 0; t < kSamples; ++t)
      stats.receivers[r].filled += window.samples[t][r] == SampleState::filled;
  }
  ++stats.windows;
  stats.windows_masked += !window.links.all();
  last_due = next.last_sample;
  end_slot += config.hop;
}

std::uint64_t FrontEnd::State::skip_before(SteadyTime time) {
  if (!line.started()) return 0;
  const std::int64_t behind = line.first_slot_from(time) - end_slot;
  const std::int64_t hops = behind <= 0 ? 0 : (behind + config.hop - 1) / config.hop;
  end_slot += hops * config.hop;
  return static_cast<std::uint64_t>(hops);
}

void FrontEnd::State::refresh(std::uint8_t receiver, SteadyTime now) {
  ReceiverStats& counters = stats.receivers[receiver];
  const Aligner::ReceiverView view = aligner.view(receiver);
  counters.offset_s = view.offset_s;
  counters.skew_ppm = view.skew_ppm;
  counters.residual_s = view.residual_s;
  counters.lost_air = view.missed;
  counters.match_ratio =
      view.heard == 0 ? 0 : static_cast<double>(view.matched) / static_cast<double>(view.heard);
  counters.rate_hz = inputs[receiver].rate_hz(now);
  stats.pauses = line.pauses();
  stats.restarts = line.restarts();
}

}  // namespace csipose
