// sim/mesh_paths.h - paths off the polygons of rooms and furniture that come as meshes.
//
// The method of images where nothing is known of the shape: each chain of polygons mirrors the transmitter, the path is found
// backwards from the receiver, each bounce must lie on its polygon, and no triangle may lie between two bounces, which Embree
// is asked. Geometry is exact (double); Embree's single precision only judges what lies between.
// Cost: polygons^order chains per antenna, most of them given up at the first polygon that is missed.
// Edges of meshes block hard: no diffraction there, other than by bodies (shadow.h).
#pragma once

#include "sim/ray_scene.h"
#include "sim/room.h"

namespace csipose::sim {

/// Triangles of one plane and material that hang together.
struct Polygon {
  Vec3 normal{};           ///< unit; either side reflects
  double offset_m = 0;     ///< of the plane: dot(normal, p)
  std::uint32_t material;  ///< of the mesh
  std::vector<std::array<Vec3, 3>> triangles;

  double height_m(const Vec3& p) const { return glm::dot(normal, p) - offset_m; }
  /// Of a point of the plane; edges belong to it.
  bool contains(const Vec3& p) const;
};
std::vector<Polygon> polygons_of(const Mesh& mesh);

/// Chains to be tried above this count are refused: an hour of work.
inline constexpr double kMostChains = 3e7;

class MeshSurfaces final : public StillSurfaces {
 public:
  /// The surface of each of the mesh's materials, in its order.
  MeshSurfaces(const Mesh& mesh, const std::vector<Surface>& surfaces);

  std::vector<StillPath> paths(const Vec3& tx, const Vec3& rx, int order) const override;
  bool is_open(const Vec3& from, const Vec3& to) const override { return !rays_.is_blocked(from, to); }
  const Mesh& mesh() const override { return mesh_; }
  std::size_t polygons() const { return polygons_.size(); }
  /// Whether something lies above and below: a device in a room without floor, or outside it, is a mistake.
  bool is_indoors(const Vec3& p) const;

 private:
  struct Search;
  void extend(Search& search) const;
  void close(Search& search) const;

  Mesh mesh_;
  std::vector<Polygon> polygons_;
  std::vector<Surface> surfaces_;
  RayScene rays_;
};

/// How many chains of up to `order` polygons there are.
double chains_of(std::size_t polygons, int order);

}  // namespace csipose::sim
