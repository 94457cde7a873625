#include "sim/mesh.h"

#include <algorithm>
#include <cmath>
#include <map>
#include <numbers>

#include "sim/geometry.h"

namespace csipose::sim {
namespace {
using Corners = std::array<std::uint32_t, 3>;
using Edge = std::pair<std::uint32_t, std::uint32_t>;

Edge undirected(std::uint32_t a, std::uint32_t b) { return {std::min(a, b), std::max(a, b)}; }

std::uint32_t add_point(Mesh& mesh, const Vec3& p) {
  mesh.points.push_back(p);
  return static_cast<std::uint32_t>(mesh.points.size() - 1);
}

/// Points in the middle of edges, one for both triangles that share an edge.
class Midpoints {
 public:
  explicit Midpoints(Mesh& mesh) : mesh_(mesh) {}
  std::uint32_t of(std::uint32_t a, std::uint32_t b) {
    const auto [found, fresh] = made_.try_emplace(undirected(a, b), 0);
    if (fresh) found->second = add_point(mesh_, (mesh_.points[a] + mesh_.points[b]) / 2.0);
    return found->second;
  }

 private:
  Mesh& mesh_;
  std::map<Edge, std::uint32_t> made_;
};

void split_all(Mesh& mesh) {
  Midpoints middle(mesh);
  std::vector<Mesh::Triangle> split;
  for (const auto& [c, material] : mesh.triangles) {
    const auto ab = middle.of(c[0], c[1]), bc = middle.of(c[1], c[2]), ca = middle.of(c[2], c[0]);
    for (const Corners& part :
         {Corners{c[0], ab, ca}, Corners{ab, c[1], bc}, Corners{ca, bc, c[2]}, Corners{ab, bc, ca}})
      split.push_back({part, material});
  }
  mesh.triangles = std::move(split);
}

Mesh icosahedron() {
  const double g = std::numbers::phi;
  Mesh mesh;
  mesh.points = {{-1, g, 0},  {1, g, 0},  {-1, -g, 0}, {1, -g, 0}, {0, -1, g},  {0, 1, g},
                 {0, -1, -g}, {0, 1, -g}, {g, 0, -1},  {g, 0, 1},  {-g, 0, -1}, {-g, 0, 1}};
  for (const Corners& c : std::initializer_list<Corners>{
           {0, 11, 5},  {0, 5, 1},  {0, 1, 7},  {0, 7, 10}, {0, 10, 11}, {1, 5, 9}, {5, 11, 4},
           {11, 10, 2}, {10, 7, 6}, {7, 1, 8},  {3, 9, 4},  {3, 4, 2},   {3, 2, 6}, {3, 6, 8},
           {3, 8, 9},   {4, 9, 5},  {2, 4, 11}, {6, 2, 10}, {8, 6, 7},   {9, 8, 1}})
    mesh.triangles.push_back({c, 0});
  return mesh;
}

Mesh unit_sphere(double edge) {
  Mesh mesh = icosahedron();
  for (Vec3& p : mesh.points) p = glm::normalize(p);
  for (double now = 1.0515; now > edge; now /= 2) {  // an icosahedron's edge over its radius
    split_all(mesh);
    for (Vec3& p : mesh.points) p = glm::normalize(p);
  }
  return mesh;
}

/// nu x nv quads over the rectangle corner, corner + u, corner + u + v, corner + v; u x v points outward.
void add_rectangle(Mesh& mesh, const Vec3& corner, const Vec3& u, const Vec3& v, double edge_m) {
  const auto pieces = [edge_m](const Vec3& side) {
    return std::max(1u, static_cast<std::uint32_t>(std::ceil(glm::length(side) / edge_m - 1e-9)));
  };
  const std::uint32_t nu = pieces(u), nv = pieces(v), first = static_cast<std::uint32_t>(mesh.points.size());
  for (std::uint32_t j = 0; j <= nv; ++j)
    for (std::uint32_t i = 0; i <= nu; ++i) add_point(mesh, corner + u * (i * 1.0 / nu) + v * (j * 1.0 / nv));
  for (std::uint32_t j = 0; j < nv; ++j)
    for (std::uint32_t i = 0; i < nu; ++i) {
      const std::uint32_t a = first + j * (nu + 1) + i, b = a + 1, c = b + nu + 1, d = a + nu + 1;
      mesh.triangles.push_back({{a, b, c}, 0});
      mesh.triangles.push_back({{a, c, d}, 0});
    }
}

Mesh box(const Vec3& half, double edge_m) {
  Mesh mesh;
  for (int axis = 0; axis < 3; ++axis)
    for (const double sign : {1.0, -1.0}) {
      Vec3 outward{0}, u{0}, v{0};
      outward[axis] = sign * half[axis];
      u[(axis + 1) % 3] = 2 * half[(axis + 1) % 3];
      v[(axis + 2) % 3] = sign * 2 * half[(axis + 2) % 3];
      add_rectangle(mesh, outward - u / 2.0 - v / 2.0, u, v, edge_m);
    }
  return welded(mesh);
}

/// A cap's rings about its middle, whose outermost is the rim.
void add_cap(Mesh& mesh, double radius, double z, std::uint32_t around, std::uint32_t rings) {
  const bool top = z > 0;
  const auto triangle = [&](std::uint32_t a, std::uint32_t b, std::uint32_t c) {
    mesh.triangles.push_back({top ? Corners{a, b, c} : Corners{a, c, b}, 0});
  };
  const std::uint32_t middle = add_point(mesh, {0, 0, z});
  for (std::uint32_t ring = 1; ring <= rings; ++ring)
    for (std::uint32_t i = 0; i < around; ++i) {
      const double angle = 2 * kPi * i / around, r = radius * ring / rings;
      add_point(mesh, {r * std::cos(angle), r * std::sin(angle), z});
    }
  for (std::uint32_t i = 0; i < around; ++i) {
    const std::uint32_t next = (i + 1) % around;
    triangle(middle, middle + 1 + i, middle + 1 + next);
    for (std::uint32_t ring = 1; ring < rings; ++ring) {
      const std::uint32_t inner = middle + 1 + (ring - 1) * around, outer = inner + around;
      triangle(inner + i, outer + i, outer + next);
      triangle(inner + i, outer + next, inner + next);
    }
  }
}

Mesh cylinder(const Vec3& half, double edge_m) {
  const double radius = half.x, h = half.z;
  const auto around = std::max(12u, static_cast<std::uint32_t>(std::ceil(2 * kPi * radius / edge_m)));
  const auto rings = std::max(1u, static_cast<std::uint32_t>(std::ceil(radius / edge_m)));
  Mesh mesh;
  add_cap(mesh, radius, h, around, rings);
  add_cap(mesh, radius, -h, around, rings);
  const auto corner = [&](std::uint32_t i) {
    const double angle = 2 * kPi * (i % around) / around;
    return Vec3{radius * std::cos(angle), radius * std::sin(angle), -h};
  };
  for (std::uint32_t i = 0; i < around; ++i)
    add_rectangle(mesh, corner(i), corner(i + 1) - corner(i), {0, 0, 2 * h}, 1.001 * edge_m);
  return welded(mesh);
}

}  // namespace

Extent extent_of(const Mesh& mesh) {
  Extent e{mesh.points.at(0), mesh.points.at(0)};
  for (const Vec3& p : mesh.points) e = {glm::min(e.low, p), glm::max(e.high, p)};
  return e;
}

Mesh welded(const Mesh& mesh, double tolerance_m) {
  // A point joins the first one of its cell of the grid or of the 26 around it that is near enough.
  using Cell = std::array<long long, 3>;
  std::map<Cell, std::vector<std::uint32_t>> cells;
  Mesh out;
  out.materials = mesh.materials;
  std::vector<std::uint32_t> now;
  const auto join = [&](const Vec3& p) -> std::uint32_t {
    const Cell cell{std::llround(p.x / tolerance_m), std::llround(p.y / tolerance_m),
                    std::llround(p.z / tolerance_m)};
    for (int n = 0; n < 27; ++n) {
      const auto found = cells.find({cell[0] + n % 3 - 1, cell[1] + n / 3 % 3 - 1, cell[2] + n / 9 - 1});
      if (found == cells.end()) continue;
      for (const std::uint32_t i : found->second)
        if (glm::distance(out.points[i], p) < tolerance_m) return i;
    }
    cells[cell].push_back(static_cast<std::uint32_t>(out.points.size()));
    return add_point(out, p);
  };
  for (const Vec3& p : mesh.points) now.push_back(join(p));
  for (const auto& [c, material] : mesh.triangles) {
    const Mesh::Triangle t{{now[c[0]], now[c[1]], now[c[2]]}, material};
    if (glm::length(out.area_vector(t)) > tolerance_m * tolerance_m) out.triangles.push_back(t);
  }
  return out;
}

MeshChecks check(const Mesh& mesh) {
  MeshChecks found;
  std::map<Edge, int> directed;
  for (const auto& t : mesh.triangles) {
    for (std::size_t i = 0; i < 3; ++i) ++directed[{t.corners[i], t.corners[(i + 1) % 3]}];
    found.volume_m3 += glm::dot(mesh.corner(t, 0), mesh.area_vector(t)) / 6;
  }
  for (const auto& [edge, times] : directed) {
    const auto back = directed.find({edge.second, edge.first});
    found.closed = found.closed && times == 1 && back != directed.end() && back->second == 1;
  }
  const Extent e = extent_of(mesh);
  const double slack_m = 1e-4 * glm::distance(e.low, e.high), outward = found.volume_m3 < 0 ? -1 : 1;
  for (const auto& t : mesh.triangles) {
    const Vec3 n = outward * glm::normalize(mesh.area_vector(t));
    const auto is_outside = [&](const Vec3& p) { return glm::dot(p - mesh.corner(t, 0), n) > slack_m; };
    if (std::any_of(mesh.points.begin(), mesh.points.end(), is_outside)) {
      found.convex = false;
      break;
    }
  }
  return found;
}

void turn_over(Mesh& mesh) {
  for (auto& t : mesh.triangles) std::swap(t.corners[1], t.corners[2]);
}

Mesh mesh_of(const Body& body, double edge_m) {
  Mesh mesh;
  if (body.shape == Shape::ellipsoid) {
    const Vec3& a = body.half_m;
    mesh = unit_sphere(edge_m / std::max({a.x, a.y, a.z}));
    for (Vec3& p : mesh.points) p *= a;
  } else {
    mesh = body.shape == Shape::box ? box(body.half_m, edge_m) : cylinder(body.half_m, edge_m);
  }
  for (Vec3& p : mesh.points) p = body.centre + body.axes * p;
  return mesh;
}

Mesh mesh_of(const Room& room, const std::array<std::string, 6>& materials) {
  Mesh mesh;
  mesh.materials.assign(materials.begin(), materials.end());
  const Vec3& size = room.size_m;
  for (std::uint32_t wall = 0; wall < kWalls; ++wall) {
    const int axis = static_cast<int>(wall) / 2, next = (axis + 1) % 3, last = (axis + 2) % 3;
    Vec3 corner{0}, u{0}, v{0};
    corner[axis] = plane_of(room, static_cast<Wall>(wall));
    u[next] = size[next];
    v[last] = size[last];
    if (wall % 2 == 1) std::swap(u, v);
    const std::size_t before = mesh.triangles.size();
    add_rectangle(mesh, corner, u, v, 1e9);
    for (std::size_t i = before; i < mesh.triangles.size(); ++i) mesh.triangles[i].material = wall;
  }
  return welded(mesh);
}

Mesh refined(const Mesh& mesh, double edge_m) {
  Mesh out;
  out.materials = mesh.materials;
  const auto longest = [](const std::array<Vec3, 3>& c) {
    return std::max({glm::distance(c[0], c[1]), glm::distance(c[1], c[2]), glm::distance(c[2], c[0])});
  };
  const auto add = [&](const auto& self, const std::array<Vec3, 3>& c, std::uint32_t material) -> void {
    if (longest(c) <= edge_m) {
      const auto a = add_point(out, c[0]), b = add_point(out, c[1]), d = add_point(out, c[2]);
      out.triangles.push_back({{a, b, d}, material});
      return;
    }
    const Vec3 ab = (c[0] + c[1]) / 2.0, bc = (c[1] + c[2]) / 2.0, ca = (c[2] + c[0]) / 2.0;
    for (const auto& part : {std::array<Vec3, 3>{c[0], ab, ca}, {ab, c[1], bc}, {ca, bc, c[2]}, {ab, bc, ca}})
      self(self, part, material);
  };
  for (const auto& t : mesh.triangles)
    add(add, {mesh.corner(t, 0), mesh.corner(t, 1), mesh.corner(t, 2)}, t.material);
  return out;
}

}  // namespace csipose::sim
