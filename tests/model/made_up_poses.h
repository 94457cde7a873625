// tests/model/made_up_poses.h - skeletons made by hand.
#pragma once

#include <cmath>
#include <numbers>
#include <random>

#include "proto/pose.h"

namespace csipose::testing {

inline Skeleton some_pose(unsigned seed) {
  std::mt19937 random(seed);
  std::normal_distribution<float> spread(0, 0.4f);
  Skeleton pose;
  for (Point3& joint : pose) joint = {spread(random), spread(random), spread(random)};
  return pose;
}
inline Skeleton moved(Skeleton pose, Point3 by) {
  for (Point3& joint : pose) joint = {joint.x + by.x, joint.y + by.y, joint.z + by.z};
  return pose;
}

/// Who stands upright, z up, arms hanging.
inline Skeleton standing_person() {
  return {{{0, 0, 1.45f},       // neck
           {0, 0, 1.65f},       // head
           {-0.2f, 0, 1.4f},    // shoulders
           {0.2f, 0, 1.4f},     //
           {-0.22f, 0, 1.1f},   // left elbow
           {-0.1f, 0, 0.9f},    // left hip
           {0.22f, 0, 1.1f},    // right elbow
           {0.1f, 0, 0.9f},     // right hip
           {-0.22f, 0, 0.85f},  // left hand
           {-0.1f, 0, 0.5f},    // left knee
           {0.22f, 0, 0.85f},   // right hand
           {0.1f, 0, 0.5f},     // right knee
           {-0.1f, 0, 0.08f},   // ankles
           {0.1f, 0, 0.08f}}};
}
/// Neck, head and arms turned forward (y) about the hips' line.
inline Skeleton leaning(Skeleton pose, float degrees) {
  const float radians = degrees * static_cast<float>(std::numbers::pi) / 180;
  for (const std::size_t joint : {0, 1, 2, 3, 4, 6, 8, 10}) {
    const float up = pose[joint].z - 0.9f;
    pose[joint].y = std::sin(radians) * up, pose[joint].z = 0.9f + std::cos(radians) * up;
  }
  return pose;
}

}  // namespace csipose::testing
