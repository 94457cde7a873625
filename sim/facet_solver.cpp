#include "sim/facet_solver.h"

#include <algorithm>
#include <cmath>

#include "sim/geometry.h"
#include "sim/pairs.h"
#include "sim/ray_scene.h"
#include "sim/reference_solver.h"

namespace csipose::sim {
namespace {
using namespace std::complex_literals;
constexpr double kLift_m = 1e-4;  // off the facet, before looking around

/// One antenna at one instant.
class FacetChannel {
 public:
  FacetChannel(const Scene& scene, const std::vector<Solid>& solids, const RayScene& rays, const Antenna& rx,
               Scatter scatter)
      : scene_(scene),
        solids_(solids),
        rays_(rays),
        rx_(rx),
        scatter_(scatter),
        lambda_m_(scene.wavelength_m()),
        h_(scene.tones.size()) {}

  std::vector<std::complex<double>> solve() {
    add_still_paths();
    for (const Solid& solid : solids_)
      for (const Pair& pair : pairs_of(scene_)) {
        const Vec3 source = source_of(scene_, pair), sink = sink_of(scene_, pair, rx_.position);
        for (const Mesh::Triangle& t : solid.mesh.triangles)
          scatter_ == Scatter::po ? add_facet(solid, t, pair, source, sink)
                                  : add_mirror(solid, t, pair, source, sink);
      }
    return std::move(h_);
  }

 private:
  void add_still_paths() {
    Scene empty = scene_;
    empty.bodies.clear();
    empty.furniture.clear();
    for (const Path& path : reference_paths(empty, rx_, 0)) {
      std::complex<double> factor = 1;
      for (const Leg& leg : path.legs) {
        if (scatter_ == Scatter::facet && rays_.is_blocked(leg.from, leg.to)) factor = 0;
        for (const Solid& solid : solids_)
          if (scatter_ == Scatter::po) factor *= hull_shadow_factor(solid.mesh.points, leg, lambda_m_);
      }
      add(path.amplitude * factor, path.length_m);
    }
  }

  void add_facet(const Solid& solid, const Mesh::Triangle& t, const Pair& pair, const Vec3& source,
                 const Vec3& sink) {
    const Vec3 area = solid.mesh.area_vector(t), normal = glm::normalize(area), middle = solid.mesh.middle(t);
    const Vec3 to_source = glm::normalize(source - middle), to_sink = glm::normalize(sink - middle);
    const double cos_in = glm::dot(normal, to_source), cos_out = glm::dot(normal, to_sink);
    if (cos_in <= 0 || cos_out <= 0) return;
    Reflection r{kWholeSurface, middle, glm::normalize(to_source + to_sink), glm::distance(source, middle),
                 glm::distance(middle, sink)};
    r.cos_incidence = glm::dot(r.normal, to_source);
    const double k = 2 * kPi / lambda_m_;
    const Vec3& vertex = solid.mesh.corner(t, 0);
    const Vec3 slope = -k * (to_source + to_sink);  // of kL
    r.spreading = 1i * k / (2 * kPi) * (cos_in + cos_out) / 2.0 * glm::length(area) / 2.0 *
                  triangle_mean(glm::dot(slope, solid.mesh.corner(t, 1) - vertex),
                                glm::dot(slope, solid.mesh.corner(t, 2) - vertex)) /
                  (r.s1_m * r.s2_m);
    add_way(solid, normal, pair, r, source, sink,
            glm::distance(source, vertex) + glm::distance(vertex, sink));
  }

  /// A plane mirror with hard edges.
  void add_mirror(const Solid& solid, const Mesh::Triangle& t, const Pair& pair, const Vec3& source,
                  const Vec3& sink) {
    const Vec3 area = solid.mesh.area_vector(t), normal = glm::normalize(area);
    const Vec3 &a = solid.mesh.corner(t, 0), &b = solid.mesh.corner(t, 1), &c = solid.mesh.corner(t, 2);
    const double height_s = glm::dot(source - a, normal), height_q = glm::dot(sink - a, normal);
    if (height_s <= 0 || height_q <= 0) return;
    const Vec3 image = source - 2 * height_s * normal;
    const Vec3 point = image + height_s / (height_s + height_q) * (sink - image);
    const auto is_left_of = [&](const Vec3& from, const Vec3& to) {
      return glm::dot(glm::cross(to - from, point - from), normal) >= 0;
    };
    if (!is_left_of(a, b) || !is_left_of(b, c) || !is_left_of(c, a)) return;
    const double length_m = glm::distance(image, sink);
    Reflection r{kWholeSurface, point, normal, glm::distance(source, point), glm::distance(point, sink)};
    r.spreading = 1 / length_m;
    add_way(solid, normal, pair, r, source, sink, length_m);
  }

  /// The facet's part by way of the pair's walls, unless a body or mesh is between.
  void add_way(const Solid& solid, const Vec3& normal, const Pair& pair, const Reflection& r,
               const Vec3& source, const Vec3& sink, double length_m) {
    const BodyWay way = body_way(scene_, pair, r, source, sink, rx_.position);
    for (std::size_t i = 0; i < way.legs; ++i) {
      const Vec3 lift = kLift_m * normal;
      const Vec3 from = way.points[i] + (i == way.body_bounce + 1 ? lift : Vec3{0});
      const Vec3 to = way.points[i + 1] + (i == way.body_bounce ? lift : Vec3{0});
      if (rays_.is_blocked(from, to, kLift_m)) return;
    }
    if (!is_open(scene_, way)) return;
    const auto gain = field_gain(
        scene_.transmitter, rx_, way.points_span(), way.normals_span(), [&](std::size_t i, double cosine) {
          return (i == way.body_bounce ? solid.surface : scene_.room.walls[way.wall_of(i)])
              .reflection(cosine, lambda_m_);
        });
    add(lambda_m_ / (4 * kPi) * r.spreading * gain, length_m);
  }

  void add(std::complex<double> amplitude, double length_m) {
    if (amplitude == 0.0) return;
    for (std::size_t k = 0; k < h_.size(); ++k) {
      const double hz = scene_.carrier_hz + scene_.tones[k] * kToneSpacing_hz;
      h_[k] += amplitude * std::polar(1.0, -2 * kPi * std::fmod(hz / kSpeedOfLight_m_s * length_m, 1.0));
    }
  }

  const Scene& scene_;
  const std::vector<Solid>& solids_;
  const RayScene& rays_;
  const Antenna& rx_;
  Scatter scatter_;
  double lambda_m_;
  std::vector<std::complex<double>> h_;
};

RayScene rays_of(const std::vector<Solid>& solids) {
  RayScene rays;
  for (const Solid& solid : solids) rays.add(solid.mesh);
  rays.commit();
  return rays;
}

Solid solid_of(const Body& body, double wavelength_m) {
  const Vec3& h = body.half_m;
  const double smallest = std::min({h.x, h.y, h.z}), largest = std::max({h.x, h.y, h.z});
  const double radius_m = body.shape == Shape::ellipsoid  ? smallest * smallest / largest
                          : body.shape == Shape::cylinder ? h.x
                                                          : 0.3;
  Mesh mesh = mesh_of(body, facet_edge_m(std::max(radius_m, 0.01), wavelength_m));
  // Flat facets between points of a curved surface lie within it, and their echo would come late: with the body's own volume
  // they lie on it in the mean.
  if (body.shape == Shape::ellipsoid) {
    const double grow = std::cbrt(4 * kPi / 3 * h.x * h.y * h.z / check(mesh).volume_m3);
    for (Vec3& p : mesh.points) p = body.centre + grow * (p - body.centre);
  }
  return {std::move(mesh), body.surface};
}

/// (1 - e^{-jz}) / (jz)
std::complex<double> mean_along(double z) {
  return std::abs(z) < 1e-4 ? 1.0 - 1i * z / 2.0 - z * z / 6 : (1.0 - std::polar(1.0, -z)) / (1i * z);
}

}  // namespace

double facet_edge_m(double radius_m, double wavelength_m) {
  const double k = 2 * kPi / wavelength_m;
  return std::sqrt(8 * radius_m * kPi / (16 * k)) / 2;
}

std::complex<double> triangle_mean(double p, double q) {
  if (std::abs(p) > std::abs(q))
    std::swap(p, q);  // the mean is the same, and the quotient by q is well behaved
  if (std::abs(q) < 1e-3) return 1.0 - 1i * (p + q) / 3.0 - (p * p + p * q + q * q) / 12.0;
  return 2.0 * (mean_along(p) - std::polar(1.0, -q) * mean_along(p - q)) / (1i * q);
}

std::vector<Solid> solids_of(const Scene& scene, double t_s) {
  std::vector<Solid> solids;
  for (const MovingBody& body : scene.bodies) solids.push_back(solid_of(body.at(t_s), scene.wavelength_m()));
  for (const MeshBody& body : scene.mesh_bodies) solids.push_back({body.at(t_s), body.surface});
  for (const Body& body : scene.furniture) solids.push_back(solid_of(body, scene.wavelength_m()));
  return solids;
}

std::vector<std::complex<double>> facet_channel(const Scene& scene, const std::vector<Solid>& solids,
                                                const Antenna& rx, Scatter scatter) {
  const RayScene rays = rays_of(solids);
  return FacetChannel(scene, solids, rays, rx, scatter).solve();
}

std::vector<std::complex<double>> solve_facets(const Scene& scene, Scatter scatter) {
  const std::size_t receivers = scene.receivers.size(), antennas = scene.receivers[0].size(),
                    tones = scene.tones.size();
  std::vector<std::complex<double>> h(static_cast<std::size_t>(scene.snapshots) * tones * receivers *
                                      antennas);
  for (int m = 0; m < scene.snapshots; ++m) {
    const auto solids = solids_of(scene, m * scene.step_s);
    const RayScene rays = rays_of(solids);
    for (std::size_t r = 0; r < receivers; ++r)
      for (std::size_t a = 0; a < antennas; ++a) {
        const auto link = FacetChannel(scene, solids, rays, scene.receivers[r][a], scatter).solve();
        for (std::size_t k = 0; k < tones; ++k)
          h[((static_cast<std::size_t>(m) * tones + k) * receivers + r) * antennas + a] = link[k];
      }
  }
  return h;
}

}  // namespace csipose::sim
