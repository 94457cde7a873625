// sim/fast_optics.h - tables and kernels behind the fast solver: coefficients of surfaces, edges, shadows.
#pragma once

#include <span>
#include <vector>

#include "sim/fast_kernels.h"
#include "sim/shadow.h"

namespace csipose::sim {

/// A surface's reflection over the cosine of incidence, 0..1, interpolated between 1024 steps.
class FresnelTable {
 public:
  FresnelTable(const Surface& surface, double wavelength_m);
  Fresnel at(double cos_incidence) const;

 private:
  std::vector<Fresnel> table_;
};

/// Cosines and sines of n equal steps of a turn, for n = 16, 32 .. 256.
class CirclePoints {
 public:
  CirclePoints();
  struct Row {
    const float* cosines;
    const float* sines;
    int points;
  };
  /// The smallest row with at least `wanted` points, or the largest.
  Row at_least(double wanted) const;

 private:
  std::vector<float> cosines_, sines_;
};
const CirclePoints& circle_points();

/// A body as the kernels take it.
struct BodyRow {
  float centre[3], j[9], radius;
  Shape shape;
};
BodyRow body_row(const Body& body);
LegRow leg_row(const Leg& leg);

/// Edges by the kernels: apertures to some 1e-3, transitions from a table to 1e-4.
class FastOptics : public EdgeOptics {
 public:
  FastOptics(const FastKernels& kernels, double wavelength_m);
  std::complex<double> aperture(const Face&, const Vec3& image, const Vec3& q,
                                const Vec3& point) const override;
  std::complex<double> transition(double v) const override;

  /// shadow_factor() of shadow.h, many at once: factors[job] for each pair of leg and body.
  struct Job {
    const LegRow* leg;
    const BodyRow* body;
  };
  void shadows(std::span<const Job> jobs, std::vector<std::complex<float>>& factors) const;

 private:
  std::complex<float> outline(const ShadowLanes& lanes, std::size_t lane, Shape shape) const;
  std::complex<double> rectangle(const Face&, const Vec3& ex, const Vec3& ey, const Vec3& along,
                                 const Vec3& point, const MirrorRay& ray) const;

  const FastKernels& kernels_;
  double wavelength_m_;
  std::vector<std::complex<double>> transitions_;
};

}  // namespace csipose::sim
