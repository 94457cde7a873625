#include "sim/fresnel.h"

#include <cmath>

#include "sim/geometry.h"

namespace csipose::sim {
namespace {
using namespace std::complex_literals;

std::complex<double> refracted_cos(std::complex<double> eta, double cos_incidence) {
  return std::sqrt(eta - (1 - cos_incidence * cos_incidence));
}

struct SlabTerms {
  Fresnel face;
  std::complex<double> crossing;  ///< e^{-jp} of one passage through the slab
};
SlabTerms slab_terms(std::complex<double> eta, double thickness_m, double wavelength_m,
                     double cos_incidence) {
  const auto q = refracted_cos(eta, cos_incidence);
  return {half_space(eta, cos_incidence), std::exp(-1i * (2 * kPi * thickness_m / wavelength_m) * q)};
}

Vec3 any_across(const Vec3& k) {
  const Vec3 other = std::abs(k.x) < 0.6 ? Vec3{1, 0, 0} : Vec3{0, 1, 0};
  return glm::normalize(glm::cross(k, other));
}
}  // namespace

Fresnel half_space(std::complex<double> eta, double cos_incidence) {
  const auto q = refracted_cos(eta, cos_incidence);
  return {(cos_incidence - q) / (cos_incidence + q), (eta * cos_incidence - q) / (eta * cos_incidence + q)};
}

Fresnel slab_reflection(std::complex<double> eta, double thickness_m, double wavelength_m,
                        double cos_incidence) {
  const SlabTerms slab = slab_terms(eta, thickness_m, wavelength_m, cos_incidence);
  const auto twice = slab.crossing * slab.crossing;
  const auto whole = [&](std::complex<double> r) { return r * (1.0 - twice) / (1.0 - r * r * twice); };
  return {whole(slab.face.te), whole(slab.face.tm)};
}

Fresnel slab_transmission(std::complex<double> eta, double thickness_m, double wavelength_m,
                          double cos_incidence) {
  const SlabTerms slab = slab_terms(eta, thickness_m, wavelength_m, cos_incidence);
  const auto through = [&](std::complex<double> r) {
    return (1.0 - r * r) * slab.crossing / (1.0 - r * r * slab.crossing * slab.crossing);
  };
  return {through(slab.face.te), through(slab.face.tm)};
}

Field reflected(const Field& field, const Vec3& k, const Vec3& n, const Fresnel& r) {
  const Vec3 across = glm::cross(k, n);
  const double length = glm::length(across);
  const Vec3 te = length < 1e-9 ? any_across(k) : across / length;
  const Vec3 tm_in = glm::cross(te, k), tm_out = glm::cross(te, mirrored(k, n));
  return r.te * field.along(te) * te + r.tm * field.along(tm_in) * tm_out;
}

}  // namespace csipose::sim
