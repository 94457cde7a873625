// sim/fresnel.h - what a plane surface gives back of a wave, and what it lets through.
//
// Field vectors are complex and global (room frame), so that a chain of reflections is a product of 3x3 maps
// with no local frames to keep in step. Slab formulas: ITU-R P.2040-3, section 2.2.2.2, all internal bounces
// included.
#pragma once

#include <complex>

#include "sim/geometry.h"

namespace csipose::sim {

/// A complex vector: an electric field.
struct Field {
  Vec3 re{}, im{};

  std::complex<double> along(const Vec3& e) const { return {glm::dot(re, e), glm::dot(im, e)}; }
};
inline Field operator*(std::complex<double> c, const Vec3& e) { return {c.real() * e, c.imag() * e}; }
inline Field operator+(const Field& a, const Field& b) { return {a.re + b.re, a.im + b.im}; }

/// Coefficients for the field across (TE) and in (TM) the plane of incidence.
struct Fresnel {
  std::complex<double> te, tm;
};
/// Surface of a half-space of relative permittivity eta.
Fresnel half_space(std::complex<double> eta, double cos_incidence);
/// Slab in air: reflected, and transmitted.
Fresnel slab_reflection(std::complex<double> eta, double thickness_m, double wavelength_m,
                        double cos_incidence);
Fresnel slab_transmission(std::complex<double> eta, double thickness_m, double wavelength_m,
                          double cos_incidence);

/// A surface's answer at any angle: a slab, or a half-space where thickness is 0.
struct Surface {
  std::complex<double> eta = 1;
  double thickness_m = 0;
  double mirrored_share = 1;  ///< of the amplitude; a rough wall scatters the rest (clutter.h)

  /// Whole, as if the surface were smooth.
  Fresnel reflection(double cos_incidence, double wavelength_m) const {
    return thickness_m > 0 ? slab_reflection(eta, thickness_m, wavelength_m, cos_incidence)
                           : half_space(eta, cos_incidence);
  }
  /// What of it goes the way of a mirror's ray.
  Fresnel mirror_reflection(double cos_incidence, double wavelength_m) const {
    const Fresnel r = reflection(cos_incidence, wavelength_m);
    return {mirrored_share * r.te, mirrored_share * r.tm};
  }
};

/// Direction of the reflected ray; k unit, n the unit normal.
inline Vec3 mirrored(const Vec3& k, const Vec3& n) { return k - 2 * glm::dot(k, n) * n; }
/// The field behind a reflection of a wave along k (unit) at a surface with unit normal n on the side of
/// incidence.
Field reflected(const Field& field, const Vec3& k, const Vec3& n, const Fresnel& r);

}  // namespace csipose::sim
