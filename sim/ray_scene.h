// sim/ray_scene.h - rays against triangles. The one place that knows Embree.
//
// Single precision inside: a hit is good to some micrometres in a room of ten metres. Whoever needs a point exactly computes it
// and asks here only what lies between.
#pragma once

#include <memory>
#include <optional>

#include "sim/mesh.h"

namespace csipose::sim {

class RayScene {
 public:
  RayScene();
  ~RayScene();
  RayScene(RayScene&&) noexcept;
  RayScene& operator=(RayScene&&) noexcept;

  /// Meshes are numbered from 0 in the order in which they come. Copies what it needs.
  void add(const Mesh& mesh);
  /// After the last mesh, before the first ray. From then on rays may come from any thread.
  void commit();

  /// Whether a triangle lies between two points, but for the last `margin_m` at either end.
  bool is_blocked(const Vec3& from, const Vec3& to, double margin_m = 1e-3) const;
  struct Hit {
    double distance_m;
    std::size_t mesh, triangle;
    double u, v;  ///< weights of the triangle's second and third corner
  };
  /// Along a unit direction, from `from_m` onward.
  std::optional<Hit> first_hit(const Vec3& origin, const Vec3& direction, double from_m = 0) const;

 private:
  struct Handles;
  std::unique_ptr<Handles> handles_;
};

}  // namespace csipose::sim
