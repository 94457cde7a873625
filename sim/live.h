// sim/live.h - three virtual receivers, in real time, through the door that real ones take.
#pragma once

#include <array>
#include <bitset>
#include <memory>
#include <optional>
#include <string>

#include "proto/datagram.h"
#include "proto/poll_stop.h"
#include "sim/moving_scene.h"
#include "sim/radio.h"

namespace csipose::sim {

struct LiveOptions {
  std::string daemon;                     ///< HOST:PORT of its UDP door
  std::array<AgentKey, kReceivers> keys;  ///< of kind simulated
  std::bitset<kReceivers> silent;         ///< receivers that are switched off
  Impairments radio = impairments(ImpairmentLevel::intel5300);
  double rate_hz = 300;  ///< packets per simulated second
  double speed = 1;      ///< simulated seconds per second
  std::uint64_t seed = 1;
  std::uint32_t clip = 0;
  std::optional<double> seconds;  ///< simulated; ends by itself after them
  std::string truth_socket;       ///< path; empty = nobody is told
  std::string what;               ///< the scene in words, for the truth socket
  std::string impair_name;        ///< likewise
};

/// Runs until the time is over or SIGINT or SIGTERM come; says on stderr how it goes. Packets flow from the moment that the
/// daemon has answered all receivers that are on; one that is restarted is found again.
void run_live(const LiveOptions& options, std::unique_ptr<MovingScene> scene, const PollStop& signals);

}  // namespace csipose::sim
