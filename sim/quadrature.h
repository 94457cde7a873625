// sim/quadrature.h - Gauss-Legendre panels along straight edges, for contour integrals.
#pragma once

#include <array>
#include <complex>

namespace csipose::sim {

/// Nodes and weights of 8 points on (-1, 1): Abramowitz and Stegun, table 25.4; symmetric, positive half.
inline constexpr std::array<double, 4> kGaussNodes{0.18343464249564980494, 0.52553240991632898582,
                                                   0.79666647741362673959, 0.96028985649753623168};
inline constexpr std::array<double, 4> kGaussWeights{0.36268378337836198297, 0.31370664587788728734,
                                                     0.22238103445337447054, 0.10122853629037625915};

/// Integral of f(t) over t in (0, 1), in `panels` equal panels of 8 points.
template <class Function>
std::complex<double> integrate_unit(int panels, const Function& f) {
  std::complex<double> sum = 0;
  const double half = 0.5 / panels;
  for (int panel = 0; panel < panels; ++panel)
    for (std::size_t i = 0; i < kGaussNodes.size(); ++i) {
      const double middle = (2 * panel + 1) * half;
      sum +=
          kGaussWeights[i] * half * (f(middle - kGaussNodes[i] * half) + f(middle + kGaussNodes[i] * half));
    }
  return sum;
}

}  // namespace csipose::sim
