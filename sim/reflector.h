// sim/reflector.h - the smallest moving scene, in closed form: a line of sight and one point that goes round
// in a circle.
//
// Line of sight by Friis, the point by the radar equation, all antennas isotropic:
//   h(f) = lambda/(4 pi d) e^{-j 2 pi f d/c}  +  lambda sqrt(sigma) / ((4 pi)^{3/2} d1 d2) e^{-j 2 pi f
//   (d1+d2)/c}
// Source: Skolnik, Introduction to Radar Systems, bistatic radar equation.
#pragma once

#include <array>

#include "sim/band.h"
#include "sim/geometry.h"

namespace csipose::sim {

struct ReflectorScene {
  Vec3 transmitter{0, 1.75, 1.0};
  std::array<AntennaArray, kReceivers> receivers{};
  Vec3 circle_centre{2.0, 1.75, 1.0};
  double circle_radius_m = 0.8;
  double speed_m_s = 1.0;
  double cross_section_m2 = 1.0;
};

/// A room of 4 x 3.5 m: the transmitter in the middle of the wall x = 0, three receivers along the wall x = 4 at y = 0.5, 1.75
/// and 3 m, all a metre high, arrays along their wall, half a wavelength between antennas. `csipose demo` says so too.
ReflectorScene default_reflector_scene(const Band& band);

/// Where the point is at time t: anticlockwise seen from above, starting towards +x.
Vec3 reflector_position(const ReflectorScene& scene, double t_s);

/// The line of sight alone, and with the reflector.
std::complex<double> line_of_sight(const Vec3& from, const Vec3& to, double frequency_hz,
                                   double wavelength_m);
Channel reflector_channel(const ReflectorScene& scene, const Band& band, double t_s);

}  // namespace csipose::sim
