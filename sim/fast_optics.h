// sim/fast_optics.h - tables and kernels behind the fast solver: coefficients of surfaces, edges, shadows.
#pragma once

#include <span>
#include <vector>

#include "sim/fast_kernels.h"
#include "sim/shadow.h"

namespace csipose::sim {

/// Geometry is in double precision, what the kernels get in single.
inline float f(double x) { return static_cast<float>(x); }

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
  std::size_t rows() const;
  /// Row i has 16 (i + 1) points.
  Row row(std::size_t i) const;
  /// The smallest row with at least `wanted` points, or the largest.
  std::size_t row_for(double wanted) const;

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

/// Bodies as columns, for one leg against all.
class BodyTable {
 public:
  void assign(std::span<const BodyRow> bodies);
  BodyColumns view() const;
  Shape shape(std::size_t i) const { return shapes_[i]; }

 private:
  std::array<std::vector<float>, 14> columns_;  ///< centre, j, radius, kind
  std::vector<Shape> shapes_;
};
LegRow leg_row(const Leg& leg);

/// Edges by the kernels: apertures to some 1e-3, transitions from a table to 1e-4.
class FastOptics : public EdgeOptics {
 public:
  FastOptics(const FastKernels& kernels, double wavelength_m);
  std::complex<double> aperture(const Face&, const Vec3& image, const Vec3& q,
                                const Vec3& point) const override;
  std::complex<double> transition(double v) const override;

  // shadow_factor() of shadow.h, many at once: factors of whatever is dimmed are multiplied up until take_shadows().

  /// Forgets all factors; there will be `count` of them.
  void begin_shadows(std::size_t count);
  /// Factor `target` is dimmed by `body` along `leg`.
  struct Job {
    const LegRow* leg;
    const BodyRow* body;
    std::uint32_t target;
  };
  void add_shadows(std::span<const Job> jobs);
  /// ... by every body of the table, but for `own` (-1: none is left out).
  void add_shadows(const LegRow& leg, const BodyTable& bodies, int own, std::uint32_t target);
  /// The factors.
  std::span<const std::complex<float>> take_shadows();

 private:
  /// Ellipses with equally many points wait here until there are sixteen.
  struct Waiting {
    OutlineLanes lanes;
    std::array<float, 16> weight;
    std::array<std::uint32_t, 16> target;
    std::size_t count = 0;
  };
  void add_view(const ShadowLanes& lanes, std::size_t lane, Shape shape, std::uint32_t target);
  void integrate(Waiting& waiting, std::size_t row);
  std::complex<float> straight_outline(const ShadowLanes& lanes, std::size_t lane, Shape shape) const;
  std::complex<double> rectangle(const Face&, const Vec3& ex, const Vec3& ey, const Vec3& along,
                                 const Vec3& point, const MirrorRay& ray) const;

  const FastKernels& kernels_;
  double wavelength_m_;
  std::vector<std::complex<double>> transitions_;
  std::vector<Waiting> waiting_;  ///< by number of points
  std::vector<std::complex<float>> factors_;
};

}  // namespace csipose::sim
