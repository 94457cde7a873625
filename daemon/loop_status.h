// daemon/loop_status.h - what the loop tells the rest of the daemon, handed over through a Snapshot.
//
// Trivially copyable: the loop copies it once a second and at a change of state.
#pragma once

#include <array>
#include <cstdint>

#include "capture/front_end.h"
#include "proto/pose.h"
#include "proto/status.h"

namespace csipose {

/// One result that was not out at its instant.
struct DeadlineMiss {
  UtcTime last_sample{};
  std::uint32_t late_us = 0;   ///< how long after the instant of publication it was ready, or the loop awake
  std::uint32_t infer_us = 0;  ///< of this, the network
};

struct LoopStatus {
  State state = State::warmup;
  Reasons reasons = 0;
  std::uint32_t people = 0;
  std::uint64_t frames = 0;                                 ///< published
  std::uint64_t ok = 0, gap = 0, skew = 0, not_finite = 0;  ///< windows, by the worst that was met
  std::uint64_t deadline = 0, skipped = 0;                  ///< results too late; windows not even begun
  static constexpr std::size_t kKeptMisses = 64;
  std::array<DeadlineMiss, kKeptMisses> misses{};  ///< the newest; number n lies at n % kKeptMisses
  std::array<LatencyHistogram, kStages> stages{};
  LatencyHistogram end_to_end{};                        ///< last sample to publication
  LinkSet links;                                        ///< of the newest window
  std::array<ReceiverQuality, kReceivers> receivers{};  ///< likewise
  std::array<UtcTime, kReceivers> last_packet{};
  FrontEndStats front_end{};
};

}  // namespace csipose
