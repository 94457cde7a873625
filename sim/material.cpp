#include "sim/material.h"

#include <cmath>

#include "sim/geometry.h"

namespace csipose::sim {
namespace {

// Gabriel's parameters of dry skin, wet skin and muscle. At 5.8 GHz they give 35.114 and 3.717 S/m for dry
// skin.
constexpr ColeCole kSkinDry{4, {{{32, 7.234e-12, 0}, {1100, 32.481e-9, 0.2}, {}, {}}}, 0.0002};
constexpr ColeCole kSkinWet{
    4, {{{39, 7.958e-12, 0.1}, {280, 79.577e-9, 0}, {3e4, 1.592e-6, 0.16}, {3e4, 1.592e-3, 0.2}}}, 0.0004};
constexpr ColeCole kMuscle{
    4, {{{50, 7.234e-12, 0.1}, {7000, 353.678e-9, 0.1}, {1.2e6, 318.31e-6, 0.1}, {2.5e7, 2.274e-3, 0}}}, 0.2};

// Order: those of the object sampler first. floorboard's law was fitted at 50-100 GHz and is extrapolated
// here.
constexpr std::array<Material, 14> kMaterials{{
    {"concrete", {5.24, 0, 0.0462, 0.7822}, 0.20},
    {"plasterboard", {2.73, 0, 0.0085, 0.9395}, 0.0125},
    {"wood", {1.99, 0, 0.0047, 1.0718}, 0.03},
    {"glass", {6.31, 0, 0.0036, 1.3394}, 0.006},
    {"brick", {3.91, 0, 0.0238, 0.16}, 0.10},
    {"ceiling_board", {1.48, 0, 0.0011, 1.0750}, 0.0125},
    {"chipboard", {2.58, 0, 0.0217, 0.78}, 0.018},
    {"plywood", {2.71, 0, 0.33, 0}, 0.012},
    {"marble", {7.074, 0, 0.0055, 0.9262}, 0.02},
    {"floorboard", {3.66, 0, 0.0044, 1.3515}, 0.02},
    {"metal", {1, 0, 1e7, 0}, 0},
    {"skin_dry", {}, 0, &kSkinDry},
    {"skin_wet", {}, 0, &kSkinWet},
    {"muscle", {}, 0, &kMuscle},
}};

std::complex<double> permittivity_of(const ColeCole& tissue, double frequency_hz) {
  using namespace std::complex_literals;
  const double omega = 2 * kPi * frequency_hz;
  std::complex<double> eta = tissue.infinity;
  for (const auto& term : tissue.terms)
    if (term.delta > 0) eta += term.delta / (1.0 + std::pow(1i * omega * term.tau_s, 1 - term.alpha));
  return eta + tissue.conductivity_S_m / (1i * omega * kVacuumPermittivity_F_m);
}

}  // namespace

std::complex<double> Material::permittivity(double frequency_hz) const {
  if (tissue) return permittivity_of(*tissue, frequency_hz);
  const double ghz = frequency_hz / 1e9;
  const double conductivity_S_m = law.c * std::pow(ghz, law.d);
  return {law.a * std::pow(ghz, law.b),
          -conductivity_S_m / (2 * kPi * frequency_hz * kVacuumPermittivity_F_m)};
}

std::span<const Material> materials() { return kMaterials; }

const Material* find_material(std::string_view name) {
  for (const Material& material : kMaterials)
    if (material.name == name) return &material;
  return nullptr;
}

}  // namespace csipose::sim
