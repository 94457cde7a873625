#include "daemon/loop.h"

#include <gtest/gtest.h>

#include "proto/wire.h"
#include "tests/daemon/scripted_loop.h"

namespace csipose {
namespace {

using namespace csipose::testing;
using namespace std::chrono_literals;

constexpr std::int64_t kNever = INT64_MAX;

/// Three receivers at 300 packets a second from 100 s on. Frames [from, to) are not heard by the receivers in
/// `deaf`.
std::vector<StoredPacket> packets(double how_long_s, std::vector<int> deaf = {}, std::int64_t from = kNever,
                                  std::int64_t to = kNever) {
  MadeUpTransmitter transmitter;
  transmitter.frames = static_cast<std::int64_t>(how_long_s * transmitter.hz);
  transmitter.frame_record = [](std::int64_t frame) {
    return csip_frame(static_cast<std::uint64_t>(frame) + 1000);
  };
  std::vector<MadeUpReceiver> receivers(3);
  for (const int r : deaf)
    receivers[static_cast<std::size_t>(r)].deaf = [=](std::int64_t frame) {
      return frame >= from && frame < to;
    };
  return make_packets(transmitter, receivers);
}

std::vector<PoseFrame> with_windows(const std::vector<PoseFrame>& frames) {
  std::vector<PoseFrame> out;
  for (const PoseFrame& frame : frames)
    if (ns(frame.window_end) != 0) out.push_back(frame);
  return out;
}
/// Longest time between two frames, from the loop's start to its end.
Nanoseconds longest_silence(const std::vector<PoseFrame>& frames) {
  Nanoseconds longest{};
  for (std::size_t i = 1; i < frames.size(); ++i)
    longest = std::max(longest, Nanoseconds(frames[i].mono_ns - frames[i - 1].mono_ns));
  return longest;
}
bool has(const PoseFrame& frame, Reason reason) { return (frame.reasons & reason_bit(reason)) != 0; }
/// Instant of the newest sample, by the steady clock that made_up_packets.h relates to UTC.
std::int64_t last_sample_ns(const PoseFrame& frame) {
  return ns(frame.window_end) - 1'700'000'000'000'000'000;
}
double last_sample_s(const PoseFrame& frame) { return seconds(Nanoseconds(last_sample_ns(frame))); }
double published_s(const PoseFrame& frame) { return seconds(Nanoseconds(frame.mono_ns)); }

TEST(LiveLoop, PublishesEveryHopAtAConstantDelay) {
  ScriptedLoop loop(packets(3.0));
  const std::vector<PoseFrame> frames = with_windows(loop.run_live(4s));
  ASSERT_GT(frames.size(), 80u);
  for (std::size_t i = 0; i < frames.size(); ++i) {
    if (frames[i].state == State::stale) break;
    const double delay_ms = static_cast<double>(frames[i].mono_ns - last_sample_ns(frames[i])) * 1e-6;
    EXPECT_NEAR(delay_ms, 50, 1.5) << i;
    if (i > 0) {
      EXPECT_EQ(frames[i].seq, frames[i - 1].seq + 1);
      EXPECT_NEAR(static_cast<double>(frames[i].mono_ns - frames[i - 1].mono_ns) * 1e-6, 1e3 / 30, 1.0) << i;
    }
  }
  EXPECT_EQ(loop.status().deadline, 0u);
}

TEST(LiveLoop, SaysWhereTheTimeWent) {
  ScriptedLoop loop(packets(2.0));
  const std::vector<PoseFrame> frames = with_windows(loop.run_live(3s));
  ASSERT_GT(frames.size(), 30u);
  const auto& spent = frames[20].latency_us;
  EXPECT_EQ(spent[static_cast<std::size_t>(Stage::infer)], 8000u);
  // Taken when the frame before is out, 50 - 33.3 ms after the newest sample, which is later than the
  // jitter's 15 ms.
  EXPECT_NEAR(spent[static_cast<std::size_t>(Stage::ingest)], 16667, 100);
  EXPECT_NEAR(spent[static_cast<std::size_t>(Stage::publish)], 50000 - 16667 - 8000, 100);
}

TEST(LiveLoop, WarmsUpInWords) {
  ScriptedLoop loop({});
  const std::vector<PoseFrame> frames = loop.run_live(5s);
  ASSERT_GE(frames.size(), 5u);
  for (const PoseFrame& frame : frames) {
    EXPECT_EQ(frame.state, State::warmup);
    EXPECT_TRUE(has(frame, Reason::no_data));
    EXPECT_EQ(frame.people_count, 0u);
  }
  EXPECT_LE(longest_silence(frames), 1s);
}

TEST(LiveLoop, DropsAndCountsWhatIsLateAndSaysSo) {
  ScriptedLoop loop(packets(4.0));
  loop.cost = [](int) { return 60ms; };
  const std::vector<PoseFrame> frames = loop.run_live(5s);
  int said = 0;
  for (const PoseFrame& frame : frames) {
    EXPECT_EQ(frame.people_count, 0u);
    said += has(frame, Reason::deadline) && frame.state == State::degraded;
  }
  EXPECT_GE(said, 3);
  EXPECT_LE(longest_silence(frames), 1s);
  EXPECT_GT(loop.status().deadline, 20u);
  EXPECT_NEAR(loop.status().misses[0].late_us, 60000 - 35000, 2000);
  EXPECT_EQ(loop.status().misses[0].infer_us, 60000u);
}

TEST(LiveLoop, OneHiccupCostsOnlyItself) {
  ScriptedLoop loop(packets(4.0));
  loop.cost = [](int run) { return run == 40 ? Nanoseconds(300ms) : Nanoseconds(8ms); };
  loop.run_live(5s);
  EXPECT_EQ(loop.status().deadline, 1u);
  EXPECT_GE(loop.status().skipped, 5u);
  EXPECT_LE(loop.status().skipped, 10u);
  EXPECT_GT(loop.status().end_to_end.count(), 80u);
}

TEST(LiveLoop, AFrameThatTheKernelMakesLateIsDroppedToo) {
  ScriptedLoop loop(packets(4.0));
  loop.clock.oversleep = [](SteadyTime instant) {
    return instant > SteadyTime(102s) && instant < SteadyTime(102'040ms) ? Nanoseconds(20ms) : Nanoseconds(0);
  };
  for (const PoseFrame& frame : with_windows(loop.run_live(5s)))
    if (frame.state != State::stale) {
      EXPECT_LE(frame.mono_ns - last_sample_ns(frame), 55'000'000);
    }
  EXPECT_GE(loop.status().deadline, 1u);
  EXPECT_LE(loop.status().deadline, 2u);
}

TEST(LiveLoop, AMissingReceiverDegradesAndComesBack) {
  ScriptedLoop loop(packets(5.0, {1}, 600, 1000));  // silent from 102 s to 103.33 s
  const std::vector<PoseFrame> frames = with_windows(loop.run_live(6s));
  const auto ends_between = [](const PoseFrame& frame, double from_s, double to_s) {
    return last_sample_s(frame) > from_s && last_sample_s(frame) < to_s;
  };
  int degraded = 0;
  for (const PoseFrame& frame : frames) {
    if (frame.state == State::stale || last_sample_s(frame) < 101) continue;
    if (ends_between(frame, 102.05, 103.3)) {
      ++degraded;
      EXPECT_EQ(frame.state, State::degraded);
      EXPECT_TRUE(has(frame, Reason::rx_missing));
      EXPECT_EQ(frame.people_count, 1u);
    } else if (!ends_between(frame, 102, 103.45) && last_sample_s(frame) < 104.9) {
      EXPECT_EQ(frame.state, State::tracking) << last_sample_ns(frame);
      EXPECT_EQ(frame.people_count, 1u);
    }
  }
  EXPECT_GT(degraded, 30);
}

TEST(LiveLoop, NobodyIsSentOnceAllIsSilentAndAllComesBack) {
  ScriptedLoop loop(packets(6.0, {0, 1, 2}, 600, 1200));  // silent from 102 s to 104 s
  const std::vector<PoseFrame> frames = loop.run_live(7s);
  int stale = 0, after = 0;
  for (const PoseFrame& frame : frames) {
    if (published_s(frame) > 102.5 && published_s(frame) < 104) {
      EXPECT_EQ(frame.people_count, 0u) << frame.mono_ns;
      stale += frame.state == State::stale && has(frame, Reason::no_data);
    }
    after += published_s(frame) > 104.5 && published_s(frame) < 106 && frame.state == State::tracking &&
             frame.people_count == 1;
  }
  EXPECT_GE(stale, 2);
  EXPECT_GT(after, 30);
  EXPECT_LE(longest_silence(frames), 1s);
}

TEST(LiveLoop, WhoComesBackAfterSilenceHasANewId) {
  ScriptedLoop loop(packets(6.0, {0, 1, 2}, 600, 1200));
  std::uint32_t before = 0, after = 0;
  for (const PoseFrame& frame : loop.run_live(7s)) {
    if (frame.people_count == 0) continue;
    (published_s(frame) < 103 ? before : after) = frame.people[0].id;
  }
  EXPECT_NE(before, 0u);
  EXPECT_GT(after, before);
}

TEST(LiveLoop, TakesNewSettingsBetweenTwoWindows) {
  ScriptedLoop loop(packets(4.0));
  bool raised = false;
  loop.during = [&](SteadyTime now) {
    if (raised || ns(now) < 102'000'000'000) return;
    loop.link.people.back() = loop.people;
    loop.link.people.back().min_score = 0.999f;
    loop.link.people.publish();
    raised = true;
  };
  int empty = 0;
  for (const PoseFrame& frame : with_windows(loop.run_live(5s))) {
    if (frame.state == State::stale) break;
    if (published_s(frame) < 102) {
      EXPECT_EQ(frame.people_count, 1u);
    }
    empty += published_s(frame) > 102.1 && frame.state == State::empty;
  }
  EXPECT_GT(empty, 30);
}

TEST(LiveLoop, AnEngineThatThrowsEndsInAFaultFrame) {
  ScriptedLoop loop(packets(4.0));
  loop.cost = [](int run) -> Nanoseconds {
    if (run == 10) throw std::runtime_error("no memory for a primitive");
    return 8ms;
  };
  const std::vector<PoseFrame> frames = loop.run_live(5s);
  EXPECT_TRUE(loop.failed);
  EXPECT_EQ(frames.back().state, State::fault);
  EXPECT_EQ(frames.back().people_count, 0u);
}

std::string as_json_lines(const std::vector<PoseFrame>& frames) {
  FrameEncoder encoder({"rx1", "rx2", "rx3"});
  std::string lines, body;
  for (const PoseFrame& frame : frames) {
    encoder.encode_body(frame, Level::pose, Format::json, body);
    lines += body;
  }
  return lines;
}

TEST(ReplayLoop, GivesTheSameBitsAtAnySpeed) {
  const auto recorded = packets(3.0, {2}, 300, 500);
  ScriptedLoop first(recorded, true, 0), second(recorded, true, 0), paced(recorded, true, 1);
  const std::string lines = as_json_lines(first.run_replay());
  EXPECT_GT(lines.size(), 10000u);
  EXPECT_EQ(as_json_lines(second.run_replay()), lines);
  EXPECT_EQ(as_json_lines(paced.run_replay()), lines);
}

TEST(ReplayLoop, RunsOnTheRecordedClock) {
  ScriptedLoop loop(packets(3.0), true);
  loop.cost = [](int) { return 200ms; };  // slower than live could be
  for (const PoseFrame& frame : with_windows(loop.run_replay())) {
    EXPECT_EQ(frame.source, Source::replay);
    EXPECT_EQ(frame.mono_ns, last_sample_ns(frame) + ns(kBudget));
    EXPECT_EQ(frame.published, frame.window_end + kBudget);
    for (const std::uint32_t spent_us : frame.latency_us) EXPECT_EQ(spent_us, 0u);
  }
  EXPECT_EQ(loop.status().deadline, 0u);
  EXPECT_EQ(loop.status().skipped, 0u);
}

TEST(ReplayLoop, IsPacedBySpeed) {
  for (const double speed : {1.0, 4.0}) {
    ScriptedLoop loop(packets(3.0), true, speed);
    loop.cost = [](int) { return 0ms; };
    const SteadyTime start = loop.clock.now();
    loop.run_replay();
    EXPECT_NEAR(seconds(loop.clock.now() - start), 3.0 / speed, 0.15) << speed;
  }
}

TEST(ReplayLoop, PassesOverALongSilence) {
  auto recorded = packets(2.0);
  for (std::size_t i = recorded.size() / 2; i < recorded.size(); ++i) recorded[i].arrival += 24h * 365 * 50;
  ScriptedLoop loop(recorded, true);
  const std::vector<PoseFrame> frames = loop.run_replay();
  EXPECT_LT(frames.size(), 3000u);
  EXPECT_NE(frames.back().state, State::fault);
}

TEST(Judge, LinksThatAreMissingDegrade) {
  Window window;
  window.links.set();
  Estimate estimate;
  EXPECT_EQ(judge(window, estimate).state, State::empty);
  estimate.people_count = 1;
  EXPECT_EQ(judge(window, estimate).state, State::tracking);
  window.reasons = kGap | kSkew;
  EXPECT_EQ(judge(window, estimate).state, State::tracking);
  EXPECT_EQ(judge(window, estimate).reasons, reason_bit(Reason::gap) | reason_bit(Reason::skew));
  window.links.reset(4);
  window.reasons = kNotFinite;
  EXPECT_EQ(judge(window, estimate).state, State::degraded);
  EXPECT_EQ(judge(window, estimate).reasons, reason_bit(Reason::nan_input));
}

TEST(Judge, WhatTheEstimatorCannotDoDegrades) {
  Window window;
  window.links.set();
  Estimate estimate;
  estimate.reasons = reason_bit(Reason::too_few_links);
  EXPECT_EQ(judge(window, estimate).state, State::degraded);
  EXPECT_EQ(judge(window, estimate).reasons, reason_bit(Reason::too_few_links));
}

}  // namespace
}  // namespace csipose
