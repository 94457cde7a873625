// sim/moving_scene.h - a room with what moves in it, snapshot by snapshot: what every program of the simulator begins with.
//
// Data sets, recordings, the live feed and pictures all take their instants from here, so the same seed shows all of them
// the same thing.
#pragma once

#include <array>
#include <memory>
#include <vector>

#include "proto/shape.h"
#include "sim/scene.h"

namespace csipose::sim {

/// The joints of one person in the order of proto/pose.h, room frame, metres.
using Joints = std::array<Vec3, kJoints>;

class MovingScene {
 public:
  struct Snapshot {
    std::vector<Body>
        bodies;  ///< the same ones in the same order at every snapshot; those that stand still too
    std::vector<Joints> people;  ///< labels; empty where nobody is
  };

  virtual ~MovingScene() = default;
  /// Room, devices and antennas, without bodies; they stay as they are.
  virtual const Scene& still() const = 0;
  /// How many people every snapshot has.
  virtual std::size_t people() const = 0;
  /// The next instant of the grid; the first call gives t = 0.
  virtual void next(Snapshot& out) = 0;
};

}  // namespace csipose::sim
