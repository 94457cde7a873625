// sim/geometry.h - vectors in the room frame: right-handed, metres, z up, origin at a floor corner.
#pragma once

#include <glm/geometric.hpp>
#include <glm/mat3x3.hpp>
#include <glm/vec3.hpp>

#include <numbers>

#include "proto/shape.h"

namespace csipose::sim {

inline constexpr double kPi = std::numbers::pi;
inline constexpr double kDegree = kPi / 180;  ///< in radians

using Vec3 = glm::dvec3;
using Mat3 = glm::dmat3;  ///< columns are the images of the axes

/// A receiver's antennas A, B, C: a line through `centre`, half a wavelength apart.
struct AntennaArray {
  Vec3 centre{};
  Vec3 axis{0, 1, 0};  ///< unit; antenna C lies further along it than A
  double spacing_m = 0;

  Vec3 element(std::size_t a) const { return centre + (static_cast<double>(a) - 1) * spacing_m * axis; }
};

}  // namespace csipose::sim
