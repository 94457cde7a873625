#include "sim/reference_solver.h"

#include <cmath>

#include "proto/intel5300.h"
#include "sim/geometry.h"
#include "sim/pairs.h"
#include "sim/shadow.h"

namespace csipose::sim {
namespace {

double free_space(const Scene& scene) { return scene.wavelength_m() / (4 * kPi); }

/// Product over all bodies, but for `own` where it touches the leg.
std::complex<double> shadow_of(const std::vector<Body>& bodies, const Leg& leg, int own,
                               double wavelength_m) {
  std::complex<double> factor = 1;
  for (std::size_t b = 0; b < bodies.size(); ++b)
    if (static_cast<int>(b) != own) factor *= shadow_factor(bodies[b], leg, wavelength_m);
  return factor;
}

std::vector<StillPath> still_paths(const Scene& scene, const Vec3& rx) {
  const Vec3& tx = scene.transmitter.position;
  if (scene.meshes) return scene.meshes->paths(tx, rx, scene.wall_order);
  std::vector<StillPath> paths;
  for (const WallPath& way : wall_paths(scene.room, tx, rx, scene.walls ? scene.wall_order : 0))
    paths.push_back({way.points, bounces_of(scene.room, way.walls), way.length_m, way});
  return paths;
}

void add_still_paths(const Scene& scene, const std::vector<Body>& bodies, const Antenna& rx,
                     std::vector<Path>& out) {
  const double lambda_m = scene.wavelength_m();
  for (const StillPath& way : still_paths(scene, rx.position)) {
    Path path;
    path.length_m = way.length_m;
    path.image = way.shoebox.index;
    path.walls = way.shoebox.walls;
    path.amplitude = free_space(scene) / way.length_m *
                     field_gain(scene.transmitter, rx, way.points, way.bounces, lambda_m);
    double before_m = 0;
    for (std::size_t i = 0; i + 1 < way.points.size(); ++i) {
      path.legs.push_back({way.points[i], way.points[i + 1], before_m, way.length_m});
      path.shadow *= shadow_of(bodies, path.legs.back(), -1, lambda_m);
      before_m += glm::distance(way.points[i], way.points[i + 1]);
    }
    out.push_back(path);
  }
}

/// Nothing where a mesh is in the way.
std::optional<Path> body_path(const Scene& scene, const std::vector<Body>& bodies, int own, const Pair& pair,
                              const Reflection& r, const Vec3& source, const Vec3& sink, const Antenna& rx) {
  const double lambda_m = scene.wavelength_m();
  const BodyWay way = body_way(scene, pair, r, source, sink, rx.position);
  if (!is_open(scene, way)) return std::nullopt;
  const Surface& surface = bodies[static_cast<std::size_t>(own)].surface;
  Path path;
  path.length_m = r.s1_m + r.s2_m;
  path.amplitude = free_space(scene) * r.spreading *
                   field_gain(scene.transmitter, rx, way.points_span(), way.normals_span(),
                              [&](std::size_t i, double cosine) {
                                return (i == way.body_bounce ? surface : scene.room.walls[way.wall_of(i)])
                                    .mirror_reflection(cosine, lambda_m);
                              });
  for (std::size_t i = 0; i < way.legs; ++i) {
    path.legs.push_back(way.leg(i, r));
    path.shadow *= shadow_of(bodies, path.legs.back(), way.touches_body(i) ? own : -1, lambda_m);
  }
  path.body = own;
  path.face = r.face;
  if (pair.before) path.wall_before = static_cast<int>(*pair.before);
  if (pair.after) path.wall_after = static_cast<int>(*pair.after);
  return path;
}

void add_body_paths(const Scene& scene, const std::vector<Body>& bodies, const Antenna& rx,
                    std::vector<Path>& out) {
  for (std::size_t b = 0; b < bodies.size(); ++b)
    for (const Pair& pair : pairs_of(scene)) {
      const Vec3 source = source_of(scene, pair), sink = sink_of(scene, pair, rx.position);
      for (const Reflection& r : reflections(bodies[b], source, sink, scene.wavelength_m()))
        if (auto path = body_path(scene, bodies, static_cast<int>(b), pair, r, source, sink, rx))
          out.push_back(*std::move(path));
    }
}

}  // namespace

std::vector<double> intel5300_tones(bool is_40mhz) {
  const auto& indices = subcarrier_indices(is_40mhz);
  return {indices.begin(), indices.end()};
}

std::vector<Path> reference_paths(const Scene& scene, const Antenna& rx, double t_s) {
  std::vector<Body> bodies;
  for (const MovingBody& body : scene.bodies) bodies.push_back(body.at(t_s));
  bodies.insert(bodies.end(), scene.furniture.begin(), scene.furniture.end());
  std::vector<Path> paths;
  add_still_paths(scene, bodies, rx, paths);
  if (scene.walls && !scene.meshes)
    for (const ClutterPath& way :
         clutter_paths(scene.room, scene.clutter, scene.transmitter, rx, scene.wavelength_m())) {
      paths.emplace_back();
      paths.back().length_m = way.length_m;
      paths.back().amplitude = way.amplitude;
      paths.back().diffuse = true;
    }
  add_body_paths(scene, bodies, rx, paths);
  return paths;
}

std::complex<double> transfer(const std::vector<Path>& paths, double frequency_hz) {
  std::complex<double> sum = 0;
  for (const Path& path : paths)
    sum += path.amplitude * path.shadow *
           std::polar(1.0, -2 * kPi * std::fmod(frequency_hz / kSpeedOfLight_m_s * path.length_m, 1.0));
  return sum;
}

std::vector<std::complex<double>> solve_reference(const Scene& scene) {
  const std::size_t receivers = scene.receivers.size(), antennas = scene.receivers[0].size(),
                    tones = scene.tones.size();
  std::vector<std::complex<double>> h(static_cast<std::size_t>(scene.snapshots) * tones * receivers *
                                      antennas);
  for (int m = 0; m < scene.snapshots; ++m)
    for (std::size_t r = 0; r < receivers; ++r)
      for (std::size_t a = 0; a < antennas; ++a) {
        const auto paths = reference_paths(scene, scene.receivers[r][a], m * scene.step_s);
        for (std::size_t k = 0; k < tones; ++k)
          h[((static_cast<std::size_t>(m) * tones + k) * receivers + r) * antennas + a] =
              transfer(paths, scene.carrier_hz + scene.tones[k] * kToneSpacing_hz);
      }
  return h;
}

}  // namespace csipose::sim
