// sim/facet_solver.h - the channel with bodies as triangles: an independent check of the analytic one, and for bodies of any
// shape.
//
//   po      physical optics: every facet that both ends see (two shadow rays, by Embree) adds
//             (jk / 2 pi) (cos i + cos o) / 2 * area * mean of e^{-jkL} over the facet / (s1 s2)
//           in the place of A e^{-jkL}; L is taken as linear over the facet. The field turns as at a mirror that halves the
//           angle between the two legs, with its Fresnel coefficients. Other paths are dimmed by the outline of each body's
//           convex hull (shadow.h), so a body with deep hollows dims too much
//   facet   what a mesh ray tracer does: each triangle is a plane mirror of its own, and what a triangle hides is gone. Neither
//           is continuous in time; kept to show by how much
//
// Walls, pairs and antennas as in the reference solver. Reference speed: seconds for twenty snapshots.
#pragma once

#include "sim/mesh.h"
#include "sim/scene.h"

namespace csipose::sim {

enum class Scatter : std::uint8_t { analytic, po, facet };

/// A body as triangles at one instant.
struct Solid {
  Mesh mesh;  ///< outward
  Surface surface;
};

/// Edges that physical optics needs for radii of curvature `radius_m`: sqrt(8 a pi / 16 k) / 2,
/// 3 cm at 0.3 m; twice as much errs by 8 % on a plate, this by 3 %.
double facet_edge_m(double radius_m, double wavelength_m);

/// Bodies, meshes among them, where they are at time t, then furniture; cut as finely as physical optics needs.
std::vector<Solid> solids_of(const Scene& scene, double t_s);

/// H[tone] from the transmitter to one antenna. Not for Scatter::analytic.
std::vector<std::complex<double>> facet_channel(const Scene& scene, const std::vector<Solid>& solids,
                                                const Antenna& rx, Scatter scatter);

/// H[snapshot][tone][receiver][antenna], C order.
std::vector<std::complex<double>> solve_facets(const Scene& scene, Scatter scatter);

/// Mean of e^{-j(a p + b q)} over the triangle a, b >= 0, a + b <= 1.
std::complex<double> triangle_mean(double p, double q);

}  // namespace csipose::sim
