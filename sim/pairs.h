// sim/pairs.h - the ways from transmitter to receiver by one body: direct, or with one wall before or after it.
#pragma once

#include <array>
#include <optional>
#include <span>
#include <vector>

#include "sim/scene.h"
#include "sim/shadow.h"

namespace csipose::sim {

/// Which wall, if any, lies on either side of the body.
struct Pair {
  std::optional<Wall> before, after;
};
/// 1, 13 or 49 of them, as the scene asks; 1 in free space.
std::vector<Pair> pairs_of(const Scene& scene);

/// The transmitter, or its image in the wall before the body; the antenna at `rx`, or its image.
Vec3 source_of(const Scene& scene, const Pair& pair);
Vec3 sink_of(const Scene& scene, const Pair& pair, const Vec3& rx);

/// A way by a body with its corners: transmitter, wall?, body, wall?, receiver.
struct BodyWay {
  std::array<Vec3, 5> points;
  std::array<Vec3, 3> normals;
  std::array<Wall, 3> walls{};  ///< by bounce; of no meaning at the body's
  std::size_t legs = 0, body_bounce = 0;

  std::span<const Vec3> points_span() const { return {points.data(), legs + 1}; }
  std::span<const Vec3> normals_span() const { return {normals.data(), legs - 1}; }
  std::size_t wall_of(std::size_t bounce) const { return static_cast<std::size_t>(walls[bounce]); }
  /// A body never dims the leg that ends or starts on it.
  bool touches_body(std::size_t i) const { return i == body_bounce || i == body_bounce + 1; }
  /// Leg i as shadows see it: up to the body from the transmitter; from there as if from the caustic behind the surface.
  Leg leg(std::size_t i, const Reflection& r) const;
};
/// Whether no mesh stands in the way.
bool is_open(const Scene& scene, const BodyWay& way);
BodyWay body_way(const Scene& scene, const Pair& pair, const Reflection& r, const Vec3& source,
                 const Vec3& sink, const Vec3& rx);

}  // namespace csipose::sim
