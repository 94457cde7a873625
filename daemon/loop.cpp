#include "daemon/loop.h"

#include <algorithm>
#include <utility>

namespace csipose {
namespace {

constexpr Nanoseconds kStateEvery =
    std::chrono::milliseconds(500);  // so that no second passes without a frame
constexpr Nanoseconds kStatusEvery = std::chrono::seconds(1);
constexpr Nanoseconds kLongestSleep = std::chrono::milliseconds(50);  // so that stop and reload are seen soon
constexpr Nanoseconds kLongestSilence =
    std::chrono::minutes(10);  // of a recording; what is longer is passed over
constexpr Nanoseconds kLateWakeUp =
    std::chrono::milliseconds(5);                                // beyond it the kernel has made us late, too
constexpr Nanoseconds kIdlePoll = std::chrono::milliseconds(5);  // while the grid is not yet known

std::uint32_t microseconds(Nanoseconds d) {
  return static_cast<std::uint32_t>(std::clamp<std::int64_t>(ns(d) / 1000, 0, UINT32_MAX));
}

}  // namespace

// ---- both ----

Loop::Loop(PacketInput& input, FrameMaker& frames, FrameSink& sink, LoopClock& clock, LoopLink& link,
           const LoopTiming& timing)
    : input_(input), frames_(frames), sink_(sink), clock_(clock), link_(link), timing_(timing) {}

void Loop::turn() {
  link_.progress.fetch_add(1, std::memory_order_relaxed);
  if (link_.people.refresh()) frames_.configure(link_.people.front());
}

void Loop::send(PoseFrame& frame, SteadyTime published, UtcTime published_utc) {
  frame.mono_ns = ns(published);
  frame.published = published_utc;
  LoopStatus& status = frames_.status();
  ++status.frames;
  sink_.publish(frame);
  last_sent_ = published;
  if (frame.state != last_state_ || published - last_status_ >= kStatusEvery) {
    last_status_ = published;
    hand_out_status();
  }
  last_state_ = frame.state;
}

/// Silence is not news: of STALE frames, two a second go out.
bool Loop::is_repetition(SteadyTime publish_at) const {
  return frames_.stale() && last_state_ == State::stale && publish_at - last_sent_ < kStateEvery;
}

void Loop::hand_out_status() {
  frames_.fill_status();
  link_.status.back() = frames_.status();
  link_.status.publish();
}

void Loop::publish_fault() {
  send(frames_.state_frame(State::fault, 0), clock_.now(), clock_.utc_now());
  hand_out_status();
}

// ---- live ----

void LiveLoop::run() {
  while (!link_.stop.load(std::memory_order_relaxed)) step();
  hand_out_status();
}

void LiveLoop::step() {
  turn();
  drain();
  const SteadyTime now = clock_.now();
  const std::optional<WindowDue> due = frames_.next();
  keep_alive(now);
  const bool first = !std::exchange(grid_known_, due.has_value()) && due;
  if (!due) return clock_.sleep_until(now + kIdlePoll);
  const SteadyTime take_at = due->last_sample + timing_.jitter;
  if (now < take_at) return clock_.sleep_until(std::min(take_at, now + kLongestSleep));
  // Behind, as at the start or after a hiccup: on with the next window that can be had in time.
  if (first || now > due->last_sample + timing_.budget) return frames_.skip_before(now - timing_.jitter);
  serve(*due);
}

void LiveLoop::drain() {
  const SteadyTime start = clock_.now();
  Packet packet;
  while (input_.poll(Nanoseconds{0}, packet) == SourceEvent::packet) frames_.add(packet);
  drained_in_ += clock_.now() - start;
}

void LiveLoop::serve(const WindowDue& due) {
  const SteadyTime begin = clock_.now();
  frames_.take(due.last_sample + timing_.jitter);
  const SteadyTime taken = clock_.now();
  frames_.estimate();
  const SteadyTime ready = clock_.now(), publish_at = due.last_sample + timing_.budget;
  if (ready > publish_at) return miss(ready, publish_at, ready - taken);
  if (is_repetition(publish_at)) return;
  wait_until(publish_at);
  const SteadyTime published = clock_.now();
  if (published > publish_at + kLateWakeUp) return miss(published, publish_at, ready - taken);
  const std::array<Nanoseconds, kStages> spent = {begin - due.last_sample, std::exchange(drained_in_, {}),
                                                  taken - begin, ready - taken, published - ready};
  send_window_frame(spent, published - due.last_sample, published);
}

void LiveLoop::send_window_frame(const std::array<Nanoseconds, kStages>& spent, Nanoseconds delay,
                                 SteadyTime published) {
  PoseFrame& frame = frames_.window_frame();
  frame.clock_error_ns = link_.clock_error_ns.load(std::memory_order_relaxed);
  if (frame.clock_error_ns == 0) frame.reasons |= reason_bit(Reason::clock_unknown);
  LoopStatus& status = frames_.status();
  for (std::size_t stage = 0; stage < kStages; ++stage) {
    frame.latency_us[stage] = microseconds(spent[stage]);
    status.stages[stage].add(frame.latency_us[stage]);
  }
  status.end_to_end.add(microseconds(delay));
  send(frame, published, clock_.utc_now());
  missed_since_sent_ = false;
}

void LiveLoop::miss(SteadyTime ready, SteadyTime deadline, Nanoseconds infer) {
  LoopStatus& status = frames_.status();
  status.misses[status.deadline % LoopStatus::kKeptMisses] = {
      clock_.utc_now() - (ready - deadline) - timing_.budget, microseconds(ready - deadline),
      microseconds(infer)};
  ++status.deadline;
  missed_since_sent_ = true;
}

void LiveLoop::wait_until(SteadyTime instant) {
  if (clock_.now() < instant) clock_.sleep_until(instant);
}

/// Where no window gives a frame: before the first one, and while all results come too late.
void LiveLoop::keep_alive(SteadyTime now) {
  if (now - last_sent_ < kStateEvery) return;
  if (!frames_.next())
    send(frames_.state_frame(State::warmup, reason_bit(Reason::no_data)), now, clock_.utc_now());
  else if (missed_since_sent_)
    send(frames_.state_frame(State::degraded, reason_bit(Reason::deadline)), now, clock_.utc_now());
  missed_since_sent_ = false;
}

// ---- replay ----

void ReplayLoop::run() {
  Packet packet;
  SourceEvent event = SourceEvent::nothing;
  while (!link_.stop.load(std::memory_order_relaxed) && event != SourceEvent::closed) {
    turn();
    event = input_.poll(kLongestSleep, packet);
    if (event == SourceEvent::packet) on_packet(packet);
  }
  for (auto due = frames_.next(); due && due->end_slot <= frames_.newest_slot() && !link_.stop;
       due = frames_.next())
    serve(*due);
  frames_.finish();
  hand_out_status();
}

void ReplayLoop::on_packet(const Packet& packet) {
  if (!frames_.receives()) first_recorded_ = packet.arrival, started_ = clock_.now();
  if (const auto due = frames_.next(); due && packet.arrival - due->last_sample > kLongestSilence)
    frames_.skip_before(packet.arrival - kLongestSilence);
  for (auto due = frames_.next(); due && packet.arrival > due->last_sample + timing_.jitter;
       due = frames_.next()) {
    turn();
    serve(*due);
  }
  frames_.add(packet);
  if (!frames_.next()) keep_alive(packet.arrival, packet.arrival_utc);
}

void ReplayLoop::serve(const WindowDue& due) {
  const Window& window = frames_.take(due.last_sample + timing_.jitter);
  frames_.estimate();
  const SteadyTime published = due.last_sample + timing_.budget;
  if (is_repetition(published)) return;
  PoseFrame& frame = frames_.window_frame();
  wait_for(published);
  send(frame, published, window.last_sample_utc + timing_.budget);
}

/// Before the first window: one frame a second of the recording.
void ReplayLoop::keep_alive(SteadyTime now, UtcTime now_utc) {
  if (frames_.status().frames > 0 && now - last_sent_ < kStateEvery) return;
  wait_for(now);
  send(frames_.state_frame(State::warmup, reason_bit(Reason::no_data)), now, now_utc);
}

void ReplayLoop::wait_for(SteadyTime recorded) {
  if (timing_.speed <= 0) return;
  const SteadyTime instant = started_ + from_seconds(seconds(recorded - first_recorded_) / timing_.speed);
  for (SteadyTime now = clock_.now(); now < instant && !link_.stop.load(std::memory_order_relaxed);
       now = clock_.now()) {
    turn();
    clock_.sleep_until(std::min(instant, now + kLongestSleep));
  }
}

}  // namespace csipose
