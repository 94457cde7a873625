// daemon/loop.h - the fixed-latency loop: when a window is taken, and when its frame goes out
// (docs/data-flow.md).
//
// For each window, with t the instant of its newest sample: packets are drained and the window is taken at t + jitter, its
// frame is published at t + budget, never sooner, and never later (but for a wake-up that the kernel delays by less
// than 5 ms): a result that is not out by then is dropped and counted. The next window is begun when this frame is
// out, so the network has min(hop, budget - jitter) to itself. At least one frame a second says how things stand.
// One thread; after construction no allocation (but the engine's own small ones, see allocation.h), no lock, no log
// call, no file.
#pragma once

#include <atomic>

#include "capture/source.h"
#include "daemon/frame_maker.h"
#include "daemon/realtime.h"
#include "daemon/snapshot.h"

namespace csipose {

/// Where the loop takes packets from: the ring that the source's thread fills.
class PacketInput {
 public:
  virtual ~PacketInput() = default;
  /// As PacketSource::poll: waits at most `timeout`; a packet's bytes are valid until the next call.
  virtual SourceEvent poll(Nanoseconds timeout, Packet& packet) = 0;
};

/// Where frames go. Never blocks, but for a replay that loses nothing.
class FrameSink {
 public:
  virtual ~FrameSink() = default;
  virtual void publish(const PoseFrame& frame) = 0;
};

struct LoopTiming {
  Nanoseconds jitter = std::chrono::milliseconds(15);
  Nanoseconds budget = std::chrono::milliseconds(50);
  double speed = 1;  ///< of a replay; 0 = as fast as possible
};

/// What goes between the loop and the main thread while the loop runs.
struct LoopLink {
  std::atomic<bool> stop{false};
  std::atomic<std::uint64_t> progress{0};  ///< counts on as long as the loop turns; feeds the watchdog
  std::atomic<std::uint64_t> clock_error_ns{0};
  Snapshot<LoopStatus> status;       ///< loop -> main
  Snapshot<EstimatorConfig> people;  ///< main -> loop: a reload
};

class Loop {
 public:
  Loop(PacketInput& input, FrameMaker& frames, FrameSink& sink, LoopClock& clock, LoopLink& link,
       const LoopTiming& timing);
  virtual ~Loop() = default;
  /// Until link.stop, or, in a replay, until the recording has ended. Throws what the engine throws.
  virtual void run() = 0;
  /// A last frame after run() has thrown: state FAULT, nobody.
  void publish_fault();

 protected:
  void turn();  ///< once per iteration: progress, new settings
  void send(PoseFrame& frame, SteadyTime published, UtcTime published_utc);
  bool is_repetition(SteadyTime publish_at) const;
  void hand_out_status();

  PacketInput& input_;
  FrameMaker& frames_;
  FrameSink& sink_;
  LoopClock& clock_;
  LoopLink& link_;
  const LoopTiming timing_;
  SteadyTime last_sent_{}, last_status_{};
  State last_state_ = State::warmup;
};

/// Paced by CLOCK_MONOTONIC; packets carry its time.
class LiveLoop final : public Loop {
 public:
  using Loop::Loop;
  void run() override;

 private:
  void drain();
  void step();
  void serve(const WindowDue& due);
  void send_window_frame(const std::array<Nanoseconds, kStages>& spent, Nanoseconds delay,
                         SteadyTime published);
  void miss(SteadyTime ready, SteadyTime deadline, Nanoseconds infer);
  void wait_until(SteadyTime instant);
  void keep_alive(SteadyTime now);

  Nanoseconds drained_in_{};  ///< time spent on packets since the last window
  bool grid_known_ = false, missed_since_sent_ = false;
};

/// Its clock is the recording's: the same packets give the same frames, bit for bit, at any speed.
class ReplayLoop final : public Loop {
 public:
  using Loop::Loop;
  void run() override;

 private:
  void on_packet(const Packet& packet);
  void serve(const WindowDue& due);
  void keep_alive(SteadyTime now, UtcTime now_utc);
  void wait_for(SteadyTime recorded);

  SteadyTime first_recorded_{}, started_{};
};

}  // namespace csipose
