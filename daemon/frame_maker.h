// daemon/frame_maker.h - a window in, the frame for subscribers out: estimates, judges the state, keeps the
// counters.
//
// What live and replay share; neither sleeps nor reads a clock here. One thread, no allocation, no lock, no
// log.
#pragma once

#include "capture/front_end.h"
#include "daemon/loop_status.h"
#include "model/pose_estimator.h"
#include "proto/pose.h"

namespace csipose {

/// What is the same for all frames of a session.
struct FrameFacts {
  std::uint64_t session = 0;
  Source source = Source::live;
  std::array<char, 12> model{};
  bool untrained = false;
  Nanoseconds stale_after = std::chrono::milliseconds(500);
};

/// State and reasons that follow from a window and what was made of it.
///   links missing, too few or not finite -> DEGRADED with reasons; otherwise TRACKING or EMPTY
///   filled samples and skew are reasons, not a state: all links are there
struct Verdict {
  State state = State::warmup;
  Reasons reasons = 0;
};
Verdict judge(const Window& window, const Estimate& estimate);

class FrameMaker {
 public:
  FrameMaker(FrontEnd& front_end, PoseEstimator& estimator, const EstimatorConfig& people,
             const FrameFacts& facts);

  void add(const Packet& packet);
  std::optional<WindowDue> next() const { return front_end_.next(); }
  std::int64_t newest_slot() const { return front_end_.newest_slot(); }
  bool receives() const { return last_arrival_ != SteadyTime{}; }

  /// Takes the window of next(); `tick` is the instant of doing so, by the clock of the packets.
  const Window& take(SteadyTime tick);
  /// Runs the network on the window taken, or, when nothing comes any more, forgets all tracks.
  void estimate();
  /// The frame for the window taken, or, without one, for a state in which there is none. `seq` is counted
  /// on. Times and latencies are the caller's to fill.
  PoseFrame& window_frame();
  PoseFrame& state_frame(State state, Reasons reasons);
  /// No more packets will come.
  void finish() { front_end_.finish(); }
  /// Windows passed over because the loop had fallen behind.
  void skip_before(SteadyTime time) { status_.skipped += front_end_.skip_before(time); }

  void configure(const EstimatorConfig& people);
  LoopStatus& status() { return status_; }
  bool stale() const { return stale_; }
  /// Puts the front end's and the newest frame's state into status().
  void fill_status();

 private:
  void begin_frame(const Verdict& verdict);
  void count_window();

  FrontEnd& front_end_;
  PoseEstimator& estimator_;
  const FrameFacts facts_;
  Window window_{};
  PoseFrame frame_{};
  LoopStatus status_{};
  const Estimate* estimate_ = nullptr;  ///< of the window taken; null when stale
  SteadyTime last_arrival_{};
  bool stale_ = false, smoothed_ = false;
  std::uint64_t seq_ = 0;
};

}  // namespace csipose
