// sim/shadow.h - how a body dims a straight leg of a path.
//
// Fresnel-Kirchhoff diffraction at an opaque screen with the body's outline, as an integral along that
// outline; nothing is ever switched on or off, so the channel stays continuous while bodies move.
#pragma once

#include <span>

#include "sim/body.h"

namespace csipose::sim {

/// A straight piece of a path.
struct Leg {
  Vec3 from{}, to{};
  double before_m = 0;  ///< length of the unfolded path from its (virtual) source to `from`
  double total_m = 0;   ///< ... and to the end of the unfolded path

  /// Where a path meets two surfaces in one point, in an edge of the room, there is nothing between them to be shadowed.
  bool is_point() const { return glm::distance(from, to) < 1e-9; }
};

/// A body as seen along a leg.
struct ShadowView {
  Vec3 along{};          ///< the leg's direction
  Vec3 u{}, v{};         ///< two across it, right-handed; only where weight > 0
  Vec3 off{};            ///< from the leg's nearest point to the body's centre
  double per_metre = 0;  ///< s: scaled coordinate per metre across; the Fresnel zones there
  double weight = 0;     ///< how much of F - 1 counts: 0 in the open and behind the leg's ends
};
ShadowView shadow_view(const Body& body, const Leg& leg, double wavelength_m);

using Vec2 = glm::dvec2;
/// A body's outline, scaled, with the ray at the origin: centre + cos first + sin second.
struct OutlineEllipse {
  Vec2 centre, first, second;
};
OutlineEllipse ellipsoid_outline(const Body& body, const ShadowView& view);
/// Corners, anticlockwise, of a box, or of a cylinder with its rims as polygons.
std::vector<Vec2> hull_outline(const Body& body, const Leg& leg, const ShadowView& view);

/// F without the blend: the outline's integral, whatever the distance. Reference quadrature (error below 1e-6).
std::complex<double> contour_shadow(const Body& body, const Leg& leg, double wavelength_m);

/// The factor on the leg: 1 where the body is clear of it by about four Fresnel zones.
std::complex<double> shadow_factor(const Body& body, const Leg& leg, double wavelength_m);

/// The same of any body, by the outline of the hull of its points.
std::complex<double> hull_shadow_factor(std::span<const Vec3> points, const Leg& leg, double wavelength_m);

/// Quintic step: 0 below 0, 1 above 1, two continuous derivatives. Also the minimum-jerk profile of motion.
double smooth_step(double t);

}  // namespace csipose::sim
