// proto/pose_geometry.h - lengths and directions of skeletons, in whatever frame. Reckoned in double.
#pragma once

#include <cmath>

#include "proto/pose.h"

namespace csipose {

/// NaN where a coordinate is: std::hypot of three forgets one beside two zeros.
inline double distance_m(const Point3& a, const Point3& b) {
  const double x = static_cast<double>(a.x) - static_cast<double>(b.x),
               y = static_cast<double>(a.y) - static_cast<double>(b.y),
               z = static_cast<double>(a.z) - static_cast<double>(b.z);
  return std::sqrt(x * x + y * y + z * z);
}

inline double mean_joint_distance_m(const Skeleton& a, const Skeleton& b) {
  double sum = 0;
  for (std::size_t j = 0; j < kJoints; ++j) sum += distance_m(a[j], b[j]);
  return sum / kJoints;
}

/// From left to right, the mean of shoulders and hips: across the way somebody faces.
inline Point3 left_to_right(const Skeleton& pose) {
  const Point3 &ls = pose[kLeftShoulder], &rs = pose[kRightShoulder], &lh = pose[kLeftHip],
               &rh = pose[kRightHip];
  return {(rs.x - ls.x + rh.x - lh.x) / 2, (rs.y - ls.y + rh.y - lh.y) / 2, (rs.z - ls.z + rh.z - lh.z) / 2};
}

}  // namespace csipose
