// sim/body.h - what moves in a room: convex opaque solids, and the points where they reflect.
//
// Geometric optics: a reflection lies where the path S - body - Q is shortest (Fermat), and its spreading
// follows from the curvature of that path length on the surface. Flat faces and cylinder ends are finite:
// they fade in and out by the Fresnel integrals of their edges. Formulas and how they were checked:
// docs/simulator.md.
#pragma once

#include <complex>
#include <optional>
#include <vector>

#include "sim/fresnel.h"

namespace csipose::sim {

enum class Shape : std::uint8_t { ellipsoid, box, cylinder };

struct Body {
  Shape shape = Shape::ellipsoid;
  Vec3 centre{};
  Mat3 axes{1};   ///< columns: the body's axes in the room, orthonormal, right-handed; a cylinder's axis is
                  ///< the third
  Vec3 half_m{};  ///< ellipsoid: semi-axes; box: half edges; cylinder: radius, radius, half height
  Surface surface;

  double bounding_radius_m() const;
  /// Reach of the body from its centre along unit direction w.
  double support_m(const Vec3& w) const;
};

/// Names the part that reflects: a box's face 2 k + (1 on the negative side), a cylinder's caps and side.
inline constexpr int kWholeSurface = -1, kCylinderTop = 10, kCylinderBottom = 11, kCylinderSide = 20;

struct Reflection {
  int face = kWholeSurface;
  Vec3 point{};               ///< of a flat face: where the mirror ray meets its plane, on the face or not
  Vec3 normal{};              ///< unit, outward
  double s1_m = 0, s2_m = 0;  ///< S to point, point to Q
  double cos_incidence = 0;
  std::complex<double> spreading{};  ///< A: what stands in for 1/length, 1/m
  std::complex<double> window = 1;   ///< the share of it that edges leave; contained in `spreading`
  double caustic_m = 0;  ///< rho_c: distance behind the surface from which the ray tube seems to come
};

/// Reflections weaker than this (|A| s1) are left out.
inline constexpr double kWeakestReflection = 1e-5;

/// A flat part of a body: a rectangle middle +- u +- v, or the disc of radius |u| = |v|; u x v points outward.
struct Face {
  int id;
  Vec3 normal, middle, u, v;
  bool round;
};

/// The diffraction of edges, which costs most of the time: plainly or fast.
class EdgeOptics {
 public:
  virtual ~EdgeOptics() = default;
  /// The share of a mirror's ray that `face` reflects: the ray runs from `image` to `q` and meets the plane in `point`.
  virtual std::complex<double> aperture(const Face& face, const Vec3& image, const Vec3& q,
                                        const Vec3& point) const = 0;
  /// edge_transition() below.
  virtual std::complex<double> transition(double v) const = 0;
};
/// Quadrature to 1e-6 and better.
class ReferenceOptics : public EdgeOptics {
 public:
  explicit ReferenceOptics(double wavelength_m) : wavelength_m_(wavelength_m) {}
  std::complex<double> aperture(const Face&, const Vec3& image, const Vec3& q,
                                const Vec3& point) const override;
  std::complex<double> transition(double v) const override;

 private:
  double wavelength_m_;
};

/// All reflections of a body between S and Q; none where a side is not lit.
std::vector<Reflection> reflections(const Body& body, const Vec3& s, const Vec3& q, double wavelength_m);

// What that is made of, for the fast solver.

/// The reflection on an ellipsoid at c + J u, u the unit vector where the way is shortest; nothing where not lit.
std::optional<Reflection> ellipsoid_reflection(const Body& body, const Vec3& u, const Vec3& s, const Vec3& q);
/// Those of a box or a cylinder.
void add_edged_reflections(const Body& body, const Vec3& s, const Vec3& q, double wavelength_m,
                           const EdgeOptics& optics, std::vector<Reflection>& out);
/// J: maps the unit sphere to the ellipsoid about its centre.
inline Mat3 stretch_of(const Body& body) {
  return {body.axes[0] * body.half_m.x, body.axes[1] * body.half_m.y, body.axes[2] * body.half_m.z};
}

/// Phi(v) = (1+j)/2 * integral of e^{-j pi t^2 / 2} from -infinity to v: 0 deep in shadow, 1/2 on the edge, 1 in the open.
std::complex<double> edge_transition(double v);

}  // namespace csipose::sim
