// sim/shadow.h - how a body dims a straight leg of a path.
//
// Fresnel-Kirchhoff diffraction at an opaque screen with the body's outline, as an integral along that
// outline; nothing is ever switched on or off, so the channel stays continuous while bodies move.
#pragma once

#include "sim/body.h"

namespace csipose::sim {

/// A straight piece of a path.
struct Leg {
  Vec3 from{}, to{};
  double before_m = 0;  ///< length of the unfolded path from its (virtual) source to `from`
  double total_m = 0;   ///< ... and to the end of the unfolded path
};

/// F without the blend: the outline's integral, whatever the distance. Reference quadrature (error below
/// 1e-6).
std::complex<double> contour_shadow(const Body& body, const Leg& leg, double wavelength_m);

/// The factor on the leg: 1 where the body is clear of it, by at least some four Fresnel zones' clearance.
std::complex<double> shadow_factor(const Body& body, const Leg& leg, double wavelength_m);

/// Quintic step: 0 below 0, 1 above 1, two continuous derivatives. Also the minimum-jerk profile of motion.
double smooth_step(double t);

}  // namespace csipose::sim
