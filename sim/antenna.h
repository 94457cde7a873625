// sim/antenna.h - how strongly, and how polarised, an antenna radiates in a direction.
#pragma once

#include <optional>
#include <string_view>

#include "sim/geometry.h"

namespace csipose::sim {

/// iso: gain 1 in every direction, vertical polarisation; dipole: short; hw_dipole: half a wavelength long.
enum class Pattern : std::uint8_t { iso, dipole, hw_dipole };
std::optional<Pattern> find_pattern(std::string_view name);

/// The real field vector of an antenna with unit axis d for radiation along unit k; its square is the gain.
/// Zero along the axis. At the receiver k points away from the antenna, by reciprocity.
Vec3 antenna_field(Pattern pattern, const Vec3& axis, const Vec3& k);

}  // namespace csipose::sim
