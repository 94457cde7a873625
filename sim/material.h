// sim/material.h - what walls and bodies are made of, as complex relative permittivity.
//
// Building materials: eps_r = a f^b, sigma = c f^d with f in GHz, Recommendation ITU-R P.2040-3, table 3.
// Tissue: the four-term Cole-Cole model of Gabriel, Lau and Gabriel, Phys. Med. Biol. 41 (1996) 2271.
#pragma once

#include <array>
#include <complex>
#include <span>
#include <string_view>

namespace csipose::sim {

inline constexpr double kVacuumPermittivity_F_m = 8.8541878128e-12;  ///< CODATA 2018

struct PowerLaw {
  double a, b, c, d;
};
struct ColeCole {
  struct Term {
    double delta, tau_s, alpha;
  };
  double infinity;
  std::array<Term, 4> terms;
  double conductivity_S_m;
};

struct Material {
  std::string_view name;
  PowerLaw law;   ///< unless `tissue` is there
  double slab_m;  ///< usual thickness as a wall; 0 = opaque
  const ColeCole* tissue = nullptr;

  bool opaque() const { return slab_m == 0; }
  /// eta = eps_r - j sigma / (2 pi f eps0), for e^{+jwt}.
  std::complex<double> permittivity(double frequency_hz) const;
};

/// Every material there is.
std::span<const Material> materials();
/// nullptr when there is no such name.
const Material* find_material(std::string_view name);

}  // namespace csipose::sim
