// tests/daemon/scripted_loop.h - a loop whose clock, packets and network are the test's: time passes when
// somebody sleeps.
#pragma once

#include <functional>
#include <memory>
#include <vector>

#include "daemon/loop.h"
#include "model/model.h"
#include "tests/capture/made_up_packets.h"

namespace csipose::testing {

/// Stands still but for sleeps and for what the network is said to cost.
class ScriptedClock final : public LoopClock {
 public:
  SteadyTime now() override { return now_; }
  UtcTime utc_now() override { return UtcTime{now_.time_since_epoch() + kUtcOffset}; }
  void sleep_until(SteadyTime instant) override {
    pass_until(instant + (oversleep ? oversleep(instant) : Nanoseconds{}));
  }
  void pass_until(SteadyTime instant) {
    now_ = std::max(now_, instant);
    if (on_time) on_time(now_);
  }
  std::function<Nanoseconds(SteadyTime)> oversleep;  ///< how much too late a sleep until then ends
  std::function<void(SteadyTime)> on_time;           ///< told whenever time has passed

 private:
  static constexpr Nanoseconds kUtcOffset{1'700'000'000'000'000'000};
  SteadyTime now_{std::chrono::seconds(99)};
};

/// Gives each packet from the instant of its arrival on; to a replay, all at once.
class ScriptedInput final : public PacketInput {
 public:
  ScriptedInput(std::vector<StoredPacket> packets, ScriptedClock* clock)
      : packets_(std::move(packets)), clock_(clock) {}
  SourceEvent poll(Nanoseconds, Packet& packet) override {
    if (next_ == packets_.size()) return clock_ == nullptr ? SourceEvent::closed : SourceEvent::nothing;
    if (clock_ != nullptr && packets_[next_].arrival > clock_->now()) return SourceEvent::nothing;
    packet = packets_[next_++].packet();
    return SourceEvent::packet;
  }

 private:
  const std::vector<StoredPacket> packets_;
  ScriptedClock* const clock_;
  std::size_t next_ = 0;
};

class CollectingSink final : public FrameSink {
 public:
  void publish(const PoseFrame& frame) override { frames.push_back(frame); }
  std::vector<PoseFrame> frames;
};

/// One person who stands at (1, 2, 1), seen as long as any link is there. `cost` may differ from run to run.
class OnePersonEngine final : public Engine {
 public:
  OnePersonEngine(std::size_t queries, ScriptedClock* clock, std::function<Nanoseconds(int run)> cost)
      : logits_(queries, -9.f), poses_(queries * kJoints * 3), clock_(clock), cost_(std::move(cost)) {
    logits_[0] = 5.f;
    for (std::size_t i = 0; i < poses_.size(); i += 3) poses_[i] = 1, poses_[i + 1] = 2, poses_[i + 2] = 1;
  }
  std::span<const float> stage(const std::string&) const override { return {}; }
  Precision precision() const override { return Precision::f32; }
  std::string describe() const override { return "scripted"; }

 private:
  NetworkOutput infer(std::span<const float>, LinkSet, const Background*) override {
    if (clock_ != nullptr) clock_->pass_until(clock_->now() + cost_(runs_));
    ++runs_;
    return {logits_, poses_, {}};
  }

  std::vector<float> logits_, poses_;
  ScriptedClock* const clock_;
  const std::function<Nanoseconds(int run)> cost_;
  int runs_ = 0;
};

inline constexpr Nanoseconds kJitter = std::chrono::milliseconds(15), kBudget = std::chrono::milliseconds(50);

/// Everything around one loop.
struct ScriptedLoop {
  explicit ScriptedLoop(std::vector<StoredPacket> packets, bool replay = false, double speed = 0)
      : input(std::move(packets), replay ? nullptr : &clock), timing{kJitter, kBudget, speed} {
    facts.source = replay ? Source::replay : Source::live;
    facts.session = 7;
  }

  std::vector<PoseFrame> run_live(Nanoseconds how_long) {
    const SteadyTime end = clock.now() + how_long;
    clock.on_time = [this, end](SteadyTime now) {
      if (during) during(now);
      if (now >= end) link.stop = true;
    };
    return run<LiveLoop>();
  }
  std::vector<PoseFrame> run_replay() { return run<ReplayLoop>(); }

  template <class Kind>
  std::vector<PoseFrame> run() {
    auto model = init_random(preset_config("micro"), 1, HeadInit::zero);
    auto engine = std::make_unique<OnePersonEngine>(model->config().queries, &clock, cost);
    PoseEstimator estimator(model, std::move(engine), people);
    FrontEnd front_end(FrontEndConfig{});
    FrameMaker frames(front_end, estimator, people, facts);
    Kind loop(input, frames, sink, clock, link, timing);
    try {
      loop.run();
    } catch (...) {
      loop.publish_fault();
      failed = true;
    }
    link.status.refresh();
    return sink.frames;
  }
  const LoopStatus& status() const { return link.status.front(); }

  ScriptedClock clock;
  ScriptedInput input;
  CollectingSink sink;
  LoopLink link;
  LoopTiming timing;
  FrameFacts facts;
  EstimatorConfig people;
  std::function<Nanoseconds(int run)> cost = [](int) { return std::chrono::milliseconds(8); };
  std::function<void(SteadyTime now)> during;
  bool failed = false;
};

}  // namespace csipose::testing
