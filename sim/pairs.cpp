#include "sim/pairs.h"

namespace csipose::sim {

std::vector<Pair> pairs_of(const Scene& scene) {
  std::vector<Pair> pairs{{}};
  if (!scene.walls || scene.pairs == 1) return pairs;
  for (std::size_t w = 0; w < kWalls; ++w) pairs.push_back({static_cast<Wall>(w), {}});
  for (std::size_t w = 0; w < kWalls; ++w) pairs.push_back({{}, static_cast<Wall>(w)});
  for (std::size_t i = 0; scene.pairs == 49 && i < kWalls * kWalls; ++i)
    pairs.push_back({static_cast<Wall>(i / kWalls), static_cast<Wall>(i % kWalls)});
  return pairs;
}

Vec3 source_of(const Scene& scene, const Pair& pair) {
  const Vec3& tx = scene.transmitter.position;
  return pair.before ? mirrored_in(scene.room, *pair.before, tx) : tx;
}

Vec3 sink_of(const Scene& scene, const Pair& pair, const Vec3& rx) {
  return pair.after ? mirrored_in(scene.room, *pair.after, rx) : rx;
}

Leg BodyWay::leg(std::size_t i, const Reflection& r) const {
  const std::size_t body_point = body_bounce + 1;
  double before_m = i < body_point ? 0 : r.caustic_m;
  for (std::size_t j = i < body_point ? 0 : body_point; j < i; ++j)
    before_m += glm::distance(points[j], points[j + 1]);
  return {points[i], points[i + 1], before_m, i < body_point ? r.s1_m : r.caustic_m + r.s2_m};
}

bool is_open(const Scene& scene, const BodyWay& way) {
  for (std::size_t i = 0; scene.meshes && i < way.legs; ++i)
    if (!scene.meshes->is_open(way.points[i], way.points[i + 1])) return false;
  return true;
}

BodyWay body_way(const Scene& scene, const Pair& pair, const Reflection& r, const Vec3& source,
                 const Vec3& sink, const Vec3& rx) {
  BodyWay way;
  std::size_t bounces = 0;
  way.points[0] = scene.transmitter.position;
  const auto bounce = [&](const Vec3& point, const Vec3& normal) {
    way.normals[bounces] = normal;
    way.points[++bounces] = point;
  };
  const auto wall_bounce = [&](Wall wall, const Vec3& from, const Vec3& to) {
    way.walls[bounces] = wall;
    bounce(crossing(scene.room, wall, from, to), inward_normal(wall));
  };
  if (pair.before) wall_bounce(*pair.before, source, r.point);
  way.body_bounce = bounces;
  bounce(r.point, r.normal);
  if (pair.after) wall_bounce(*pair.after, r.point, sink);
  way.points[bounces + 1] = rx;
  way.legs = bounces + 1;
  return way;
}

}  // namespace csipose::sim
