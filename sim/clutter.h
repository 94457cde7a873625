// sim/clutter.h - what rough walls scatter: a still, diffuse part of the channel.
//
// The effective roughness model (Degli-Esposti et al., IEEE Trans. Antennas Propag. 55 (2007) 143): a tile of wall takes the
// share S^2 of what it would reflect and sends it in a pattern f over the half-space; what it reflects like a mirror keeps
// sqrt(1 - S^2). Each tile's phase is drawn once. The scattered field is kept in the vertical plane. People do not shadow it.
#pragma once

#include <complex>
#include <cstdint>

#include "sim/room.h"

namespace csipose::sim {

enum class ScatterPattern : std::uint8_t { lambertian, directive, backscatter };

struct Clutter {
  double scattering = 0;  ///< S, 0..1; 0 = none. Typical walls 0.1 to 0.4
  ScatterPattern pattern = ScatterPattern::directive;
  int forward_exponent = 4,
      backward_exponent = 4;   ///< alpha_R about the mirrored ray, alpha_I about where it came from
  double forward_share = 0.5;  ///< Lambda, of `backscatter`
  std::uint64_t seed = 1;      ///< of the tiles' phases
  std::uint32_t clip = 0;
};

/// f, per steradian: what goes along unit k_out of what came along unit k_in to a wall with unit normal n; its integral over
/// the half-space before the wall is 1.
double scatter_pattern(const Clutter& clutter, const Vec3& normal, const Vec3& k_in, const Vec3& k_out);
/// Integral over the half-space of ((1 + cos psi) / 2)^alpha, psi the angle to a ray that leaves under `cos_incidence`.
double lobe_integral(int alpha, double cos_incidence);

/// One tile's way.
struct ClutterPath {
  double length_m;
  std::complex<double> amplitude;  ///< antennas, spreading and the tile's phase
};
/// By tiles of 0.5 m at most on all six walls.
std::vector<ClutterPath> clutter_paths(const Room& room, const Clutter& clutter, const Antenna& tx,
                                       const Antenna& rx, double wavelength_m);

}  // namespace csipose::sim
