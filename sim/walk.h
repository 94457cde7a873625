// sim/walk.h - walking, along a straight line or round a circle: feet that do not skate, and the rest follows.
//
// Stride against speed: Boulic, Magnenat Thalmann and Thalmann, "A global human walking model with real-time kinematic
// personification", The Visual Computer 6 (1990). A foot on the ground is fixed until its heel rises.
#pragma once

#include "sim/human.h"

namespace csipose::sim {

/// Where a walker goes; arc length 0 is at `start`.
struct Course {
  Vec3 start{};               ///< z is of no meaning
  double heading_rad = 0;     ///< at the start
  double turn_rad_per_m = 0;  ///< to the left; 0 = straight

  double heading_at(double arc_m) const { return heading_rad + turn_rad_per_m * arc_m; }
  Vec3 at(double arc_m) const;
};

struct Gait {
  Gait(const Figure& person, double speed);
  Figure figure;
  double speed_m_s;
  double stride_m, cycle_s, stance_fraction;

  /// A foot's place: arc length along the course and height of the ankle.
  struct Foot {
    double arc_m, ankle_z_m;
  };
  Foot foot_at(std::size_t side, double t_s) const;
};

/// The walker t after the right heel's strike, on `course` at arc length speed * t. Requires 0.3 <= speed <= 1.5 m/s.
Posture walking(const Gait& gait, const Course& course, double t_s);

}  // namespace csipose::sim
