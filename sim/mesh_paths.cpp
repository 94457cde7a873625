#include "sim/mesh_paths.h"

#include <cmath>
#include <map>
#include <numeric>

namespace csipose::sim {
namespace {

constexpr double kSamePlane = 1e-6;  // of directions, and metres
constexpr double kOnEdge_m = 1e-9;   // a bounce on the seam of two triangles belongs to both
constexpr double kOnPlane_m = 1e-9;  // an antenna in a polygon's plane sees nothing in it

/// Sets that grow together.
class Groups {
 public:
  explicit Groups(std::size_t n) : parent_(n) { std::iota(parent_.begin(), parent_.end(), std::size_t{0}); }
  std::size_t of(std::size_t i) {
    while (parent_[i] != i) i = parent_[i] = parent_[parent_[i]];
    return i;
  }
  void join(std::size_t a, std::size_t b) { parent_[std::max(of(a), of(b))] = std::min(of(a), of(b)); }

 private:
  std::vector<std::size_t> parent_;
};

bool is_inside(const std::array<Vec3, 3>& t, const Vec3& p, const Vec3& normal) {
  for (std::size_t i = 0; i < 3; ++i) {
    const Vec3 edge = t[(i + 1) % 3] - t[i];
    // Twice the area on the wrong side of an edge, over its length: the distance from it.
    if (glm::dot(glm::cross(edge, p - t[i]), normal) < -kOnEdge_m * glm::length(edge)) return false;
  }
  return true;
}

Vec3 mirrored_in(const Polygon& polygon, const Vec3& p) {
  return p - 2 * polygon.height_m(p) * polygon.normal;
}

}  // namespace

bool Polygon::contains(const Vec3& p) const {
  for (const auto& t : triangles)
    if (is_inside(t, p, normal)) return true;
  return false;
}

std::vector<Polygon> polygons_of(const Mesh& mesh) {
  const std::size_t n = mesh.triangles.size();
  std::vector<Vec3> normals;
  for (const auto& t : mesh.triangles) normals.push_back(glm::normalize(mesh.area_vector(t)));
  Groups groups(n);
  std::map<std::pair<std::uint32_t, std::uint32_t>, std::vector<std::size_t>> at_edge;
  for (std::size_t i = 0; i < n; ++i)
    for (std::size_t c = 0; c < 3; ++c) {
      const auto& t = mesh.triangles[i];
      const auto a = t.corners[c], b = t.corners[(c + 1) % 3];
      auto& others = at_edge[{std::min(a, b), std::max(a, b)}];
      for (const std::size_t j : others) {
        const Vec3 off = mesh.middle(t) - mesh.corner(mesh.triangles[j], 0);
        if (mesh.triangles[j].material == t.material &&
            glm::dot(normals[i], normals[j]) > 1 - kSamePlane * kSamePlane / 2 &&
            std::abs(glm::dot(off, normals[j])) < kSamePlane)
          groups.join(i, j);
      }
      others.push_back(i);
    }
  std::vector<Polygon> polygons;
  std::map<std::size_t, std::size_t> polygon_of;
  for (std::size_t i = 0; i < n; ++i) {
    const auto& t = mesh.triangles[i];
    const auto [at, fresh] = polygon_of.try_emplace(groups.of(i), polygons.size());
    if (fresh) polygons.push_back({normals[i], glm::dot(normals[i], mesh.corner(t, 0)), t.material, {}});
    polygons[at->second].triangles.push_back({mesh.corner(t, 0), mesh.corner(t, 1), mesh.corner(t, 2)});
  }
  return polygons;
}

double chains_of(std::size_t polygons, int order) {
  double sum = 1, product = 1;
  for (int i = 0; i < order; ++i) sum += product *= static_cast<double>(polygons) - (i > 0 ? 1 : 0);
  return sum;
}

/// A chain that grows polygon by polygon.
struct MeshSurfaces::Search {
  Vec3 rx;
  int order;
  std::vector<std::size_t> chain;
  std::vector<Vec3> images;  ///< transmitter, then mirrored in each polygon of the chain
  std::vector<StillPath> found;
};

MeshSurfaces::MeshSurfaces(const Mesh& mesh, const std::vector<Surface>& surfaces)
    : mesh_(mesh), polygons_(polygons_of(mesh)), surfaces_(surfaces) {
  rays_.add(mesh);
  rays_.commit();
}

std::vector<StillPath> MeshSurfaces::paths(const Vec3& tx, const Vec3& rx, int order) const {
  Search search{rx, order, {}, {tx}, {}};
  extend(search);
  return std::move(search.found);
}

void MeshSurfaces::extend(Search& search) const {
  close(search);
  if (static_cast<int>(search.chain.size()) == search.order) return;
  for (std::size_t p = 0; p < polygons_.size(); ++p) {
    if (!search.chain.empty() && search.chain.back() == p) continue;
    if (std::abs(polygons_[p].height_m(search.images.back())) < kOnPlane_m) continue;
    search.chain.push_back(p);
    search.images.push_back(mirrored_in(polygons_[p], search.images.back()));
    extend(search);
    search.chain.pop_back();
    search.images.pop_back();
  }
}

/// Keeps the chain if there is a path along it.
void MeshSurfaces::close(Search& search) const {
  const std::size_t bounces = search.chain.size();
  StillPath path;
  path.points.resize(bounces + 2);
  path.points.front() = search.images.front();
  path.points.back() = search.rx;
  for (std::size_t i = bounces; i > 0; --i) {
    const Polygon& polygon = polygons_[search.chain[i - 1]];
    const Vec3 &from = search.images[i], &to = path.points[i + 1];
    const double behind = polygon.height_m(from), before = polygon.height_m(to);
    if (std::abs(before) < kOnPlane_m) {
      // Into an edge where two polygons meet: a path of either order, and the same one.
      if (i == bounces || search.chain[i - 1] > search.chain[i]) return;
      path.points[i] = to;
    } else {
      if (behind * before >= 0) return;
      path.points[i] = from + behind / (behind - before) * (to - from);
    }
    if (!polygon.contains(path.points[i])) return;
  }
  for (std::size_t i = 0; i <= bounces; ++i)
    if (!is_open(path.points[i], path.points[i + 1])) return;
  for (std::size_t i = 0; i < bounces; ++i) {
    const Polygon& polygon = polygons_[search.chain[i]];
    const double side = polygon.height_m(search.images[i]) > 0 ? 1 : -1;  // where the wave comes from
    path.bounces.push_back({side * polygon.normal, surfaces_[polygon.material]});
  }
  path.length_m = glm::distance(search.images.back(), search.rx);
  search.found.push_back(std::move(path));
}

bool MeshSurfaces::is_indoors(const Vec3& p) const {
  return rays_.first_hit(p, {0, 0, 1}).has_value() && rays_.first_hit(p, {0, 0, -1}).has_value();
}

}  // namespace csipose::sim
