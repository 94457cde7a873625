#include "sim/antenna.h"

#include <cmath>

#include "sim/geometry.h"

namespace csipose::sim {
namespace {

double amplitude(Pattern pattern, double cos_theta, double sin_theta) {
  switch (pattern) {
    case Pattern::iso:
      return 1;
    case Pattern::dipole:
      return std::sqrt(1.5) * sin_theta;
    // Exact directivity of the half-wave dipole is 1.6409; 1.643 is what Sionna RT uses, kept for
    // comparability.
    case Pattern::hw_dipole:
      return std::sqrt(1.643) * std::cos(kPi / 2 * cos_theta) / sin_theta;
  }
  return 0;
}

}  // namespace

std::optional<Pattern> find_pattern(std::string_view name) {
  if (name == "iso") return Pattern::iso;
  if (name == "dipole") return Pattern::dipole;
  if (name == "hw_dipole") return Pattern::hw_dipole;
  return std::nullopt;
}

Vec3 antenna_field(Pattern pattern, const Vec3& axis, const Vec3& k) {
  const double cos_theta = glm::dot(k, axis);
  const double sin_theta = std::sqrt(std::max(0.0, 1 - cos_theta * cos_theta));
  if (sin_theta < 1e-9) return Vec3{0};
  return amplitude(pattern, cos_theta, sin_theta) / sin_theta * (cos_theta * k - axis);
}

}  // namespace csipose::sim
