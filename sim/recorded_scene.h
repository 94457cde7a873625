// sim/recorded_scene.h - scenes that run on: one channel per packet, and where people are.
#pragma once

#include <memory>
#include <vector>

#include "sim/band.h"
#include "sim/geometry.h"

namespace csipose::sim {

/// The room at the instant of one packet.
struct Instant {
  Channel channel;
  std::vector<std::array<Vec3, kJoints>> people;  ///< joints in the order of proto/pose.h, room frame, metres
};

class RecordedScene {
 public:
  virtual ~RecordedScene() = default;
  virtual std::size_t people() const = 0;
  /// The next instant of the grid; valid until the next call.
  virtual const Instant& next() = 0;
};

/// reflector.h: nobody there, in closed form.
std::unique_ptr<RecordedScene> reflector_scene(double rate_hz);
/// One person of 1.72 m walks round a room of 4 x 3.5 x 2.6 m at 0.7 m/s, in a circle of 0.9 m about its middle; the
/// transmitter at one wall, a receiver at each other, a metre high.
std::unique_ptr<RecordedScene> walking_scene(double rate_hz);

}  // namespace csipose::sim
