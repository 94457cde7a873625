// sim/mesh.h - surfaces as triangles: rooms and furniture that people have drawn, bodies of any shape, and our own solids as
// a mesh tracer or a picture wants them.
#pragma once

#include <cstdint>
#include <map>
#include <string>
#include <vector>

#include "sim/body.h"
#include "sim/room.h"

namespace csipose::sim {

struct Mesh {
  struct Triangle {
    std::array<std::uint32_t, 3> corners{};  ///< anticlockwise as seen from outside
    std::uint32_t material = 0;              ///< index of `materials`
  };
  std::vector<Vec3> points;  ///< metres
  std::vector<Triangle> triangles;
  std::vector<std::string> materials;  ///< names of material.h

  const Vec3& corner(const Triangle& t, std::size_t i) const { return points[t.corners[i]]; }
  Vec3 middle(const Triangle& t) const { return (corner(t, 0) + corner(t, 1) + corner(t, 2)) / 3.0; }
  /// Along the outward normal; its length is twice the triangle's area.
  Vec3 area_vector(const Triangle& t) const {
    return glm::cross(corner(t, 1) - corner(t, 0), corner(t, 2) - corner(t, 0));
  }
};

/// What a mesh file itself does not tell.
struct MeshImport {
  double scale = 1;                              ///< metres per unit of the file
  std::string material;                          ///< of faces that name none; may be empty when all do
  std::map<std::string, std::string> materials;  ///< names in the file that stand for ours
  bool only_material = false;                    ///< `material` everywhere, whatever the file says
};

struct Extent {
  Vec3 low, high;
};
/// Of a mesh with points.
Extent extent_of(const Mesh& mesh);

/// Points nearer than `tolerance_m` (and in one cell of a grid) become one; triangles that this leaves without area go.
/// Exporters write a corner once per face: without welding nothing is closed.
Mesh welded(const Mesh& mesh, double tolerance_m = 1e-5);

/// What a welded mesh is good for.
struct MeshChecks {
  bool closed = true;    ///< every edge has two triangles, which run along it in opposite senses
  bool convex = true;    ///< no point lies outside any triangle's plane, by 1e-4 of the size
  double volume_m3 = 0;  ///< negative: normals point inward
};
MeshChecks check(const Mesh& mesh);
/// Every triangle the other way round.
void turn_over(Mesh& mesh);

/// The body's surface with edges no longer than about `edge_m`; points lie on the surface. Closed, outward.
Mesh mesh_of(const Body& body, double edge_m);
/// The walls of a shoebox, normals inward; materials as given, in the order of Wall.
Mesh mesh_of(const Room& room, const std::array<std::string, 6>& materials);
/// Every triangle split in four until no edge is longer than `edge_m`.
Mesh refined(const Mesh& mesh, double edge_m);

}  // namespace csipose::sim
