// Meshes: what they are, what Embree sees of them, and the paths off them.
#include "sim/mesh.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>

#include "sim/fast_solver.h"
#include "sim/geometry.h"
#include "sim/material.h"
#include "sim/mesh_paths.h"
#include "sim/reference_solver.h"
#include "tests/sim/mixed_scene.h"

namespace csipose::sim {
namespace {

Body body(Shape shape, const Vec3& half) {
  Body b;
  b.shape = shape;
  b.centre = {0.3, -0.2, 1.1};
  b.half_m = half;
  const Vec3 x = glm::normalize(Vec3{1, 0.4, 0.2}), z = glm::normalize(glm::cross(x, Vec3{0.1, 1, 0.3}));
  b.axes = {x, glm::cross(z, x), z};
  return b;
}

std::vector<Surface> surfaces_of(const Mesh& mesh, double thickness_m) {
  std::vector<Surface> surfaces;
  for (const std::string& name : mesh.materials)
    surfaces.push_back({find_material(name)->permittivity(5.64e9), thickness_m});
  return surfaces;
}

TEST(MeshOfBody, IsClosedConvexOutwardAndOfTheRightVolume) {
  const std::vector<std::pair<Body, double>> solids{
      {body(Shape::ellipsoid, {0.3, 0.2, 0.1}), 4 / 3.0 * kPi * 0.3 * 0.2 * 0.1},
      {body(Shape::box, {0.3, 0.2, 0.1}), 8 * 0.3 * 0.2 * 0.1},
      {body(Shape::cylinder, {0.2, 0.2, 0.4}), kPi * 0.2 * 0.2 * 0.8}};
  for (const auto& [solid, volume] : solids) {
    const Mesh mesh = mesh_of(solid, 0.02);
    const MeshChecks found = check(mesh);
    EXPECT_TRUE(found.closed);
    EXPECT_TRUE(found.convex);
    EXPECT_NEAR(found.volume_m3 / volume, 1, 0.01);
    EXPECT_LT(found.volume_m3, volume * (1 + 1e-9)) << "points lie on the surface, so the mesh lies within";
  }
}

TEST(MeshOfBody, ReachesAsFarAsTheBody) {
  for (const Shape shape : {Shape::ellipsoid, Shape::box, Shape::cylinder}) {
    const Body solid = body(shape, shape == Shape::cylinder ? Vec3{0.15, 0.15, 0.3} : Vec3{0.3, 0.2, 0.1});
    const Mesh mesh = mesh_of(solid, 0.02);
    for (int i = 0; i < 50; ++i) {
      const double angle = 0.7 * i, z = -1 + i / 25.0;
      const Vec3 w{std::sqrt(1 - z * z) * std::cos(angle), std::sqrt(1 - z * z) * std::sin(angle), z};
      double reach = 0;
      for (const Vec3& p : mesh.points) reach = std::max(reach, glm::dot(p - solid.centre, w));
      EXPECT_NEAR(reach, solid.support_m(w), 0.003);
    }
  }
}

TEST(RayScene, SeesABodyWhereItsOutlineIs) {
  const Body ball = body(Shape::ellipsoid, {0.3, 0.3, 0.3});
  RayScene rays;
  rays.add(mesh_of(ball, 0.02));
  rays.commit();
  for (int i = 0; i <= 60; ++i) {
    const double off = -0.6 + 0.02 * i + 0.003;
    const Vec3 origin = ball.centre + Vec3{-3, off, 0.05};
    const double distance = std::hypot(off, 0.05);
    if (std::abs(distance - 0.3) < 0.003) continue;
    EXPECT_EQ(rays.is_blocked(origin, origin + Vec3{6, 0, 0}), distance < 0.3) << off;
    const auto hit = rays.first_hit(origin, {1, 0, 0});
    ASSERT_EQ(hit.has_value(), distance < 0.3);
    if (hit) {
      EXPECT_NEAR(hit->distance_m, 3 - std::sqrt(0.09 - distance * distance), 0.01);
    }
  }
  EXPECT_FALSE(rays.is_blocked(ball.centre + Vec3{-3, 0, 0}, ball.centre + Vec3{-1, 0, 0}));
}

TEST(Check, FindsAHoleAndADent) {
  Mesh mesh = mesh_of(body(Shape::box, {0.3, 0.2, 0.1}), 0.1);
  Mesh open = mesh;
  open.triangles.pop_back();
  EXPECT_FALSE(check(open).closed);
  Mesh inside_out = mesh;
  turn_over(inside_out);
  EXPECT_TRUE(check(inside_out).closed);
  EXPECT_TRUE(check(inside_out).convex);
  EXPECT_LT(check(inside_out).volume_m3, 0);
  const Vec3 middle = body(Shape::box, {}).centre;
  auto& face_point = *std::min_element(
      mesh.points.begin(), mesh.points.end(),
      [&](const Vec3& p, const Vec3& q) { return glm::distance(p, middle) < glm::distance(q, middle); });
  face_point += 0.05 * (middle - face_point);
  EXPECT_TRUE(check(mesh).closed);
  EXPECT_FALSE(check(mesh).convex);
}

TEST(Refined, KeepsTheSurface) {
  const Mesh mesh = mesh_of(body(Shape::box, {0.3, 0.2, 0.1}), 1), fine = refined(mesh, 0.05);
  EXPECT_GT(fine.triangles.size(), 16 * mesh.triangles.size());
  double before = 0, after = 0;
  for (const auto& t : mesh.triangles) before += glm::length(mesh.area_vector(t));
  for (const auto& t : fine.triangles) {
    after += glm::length(fine.area_vector(t));
    for (std::size_t i = 0; i < 3; ++i)
      EXPECT_LE(glm::distance(fine.corner(t, i), fine.corner(t, (i + 1) % 3)), 0.05);
  }
  EXPECT_NEAR(after, before, 1e-9);
}

/// The mixed room as a mesh; its walls have the slabs that the scene's have.
std::shared_ptr<const MeshSurfaces> mesh_room(const Scene& scene) {
  const Mesh mesh =
      mesh_of(scene.room, {"concrete", "plasterboard", "glass", "wood", "concrete", "plasterboard"});
  return std::make_shared<const MeshSurfaces>(
      mesh, std::vector<Surface>(scene.room.walls.begin(), scene.room.walls.end()));
}

TEST(MeshRoom, AShoeboxHasThePathsOfItsImages) {
  const Scene scene = mixed_scene();
  const auto room = mesh_room(scene);
  EXPECT_EQ(room->polygons(), 6u);
  const Vec3 &tx = scene.transmitter.position, &rx = scene.receivers[0][0].position;
  const auto expected = wall_paths(scene.room, tx, rx, 3);
  const auto found = room->paths(tx, rx, 3);
  ASSERT_EQ(found.size(), expected.size());
  for (const WallPath& path : expected) {
    const auto same = [&](const StillPath& other) {
      if (other.points.size() != path.points.size() || std::abs(other.length_m - path.length_m) > 1e-12)
        return false;
      for (std::size_t p = 0; p < path.points.size(); ++p)
        if (glm::distance(other.points[p], path.points[p]) > 1e-10) return false;
      return true;
    };
    EXPECT_EQ(std::count_if(found.begin(), found.end(), same), 1)
        << path.index.x << path.index.y << path.index.z;
  }
}

double relative_error(const std::vector<std::complex<double>>& found,
                      const std::vector<std::complex<double>>& expected) {
  double error = 0, power = 0;
  for (std::size_t i = 0; i < expected.size(); ++i) {
    error = std::max(error, std::abs(found[i] - expected[i]));
    power += std::norm(expected[i]) / static_cast<double>(expected.size());
  }
  return error / std::sqrt(power);
}

TEST(MeshRoom, AShoeboxHasItsChannel) {
  Scene moving = mixed_scene();
  moving.snapshots = 2;
  Scene still = moving;
  still.bodies.clear();
  const auto walls = solve_reference(still), all = solve_reference(moving);
  moving.meshes = still.meshes = mesh_room(still);
  EXPECT_LT(relative_error(solve_reference(still), walls), 1e-9);
  // A flat face's mirror point may lie beyond a wall, where a mesh hides it: a contribution of little weight.
  EXPECT_LT(relative_error(solve_reference(moving), all), 5e-3);
}

TEST(MeshRoom, BothSolversTakeIt) {
  Scene scene = mixed_scene();
  scene.snapshots = 3;
  scene.meshes = mesh_room(scene);
  const auto fast = solve_fast(scene);
  const auto reference = solve_reference(scene);
  double error = 0, power = 0;
  for (std::size_t i = 0; i < fast.size(); ++i) {
    error += std::norm(std::complex<double>(fast[i]) - reference[i]);
    power += std::norm(reference[i]);
  }
  EXPECT_LT(std::sqrt(error / power), 1e-2);
}

/// An L: 6 x 3 m with 3 x 3 m more on its left half, 2.5 m high.
Mesh l_room() {
  const std::vector<Vec3> floor{{0, 0, 0}, {6, 0, 0}, {6, 3, 0}, {3, 3, 0}, {3, 6, 0}, {0, 6, 0}};
  Mesh mesh;
  mesh.materials = {"concrete"};
  for (const Vec3& p : floor) mesh.points.push_back(p);
  for (const Vec3& p : floor) mesh.points.push_back(p + Vec3{0, 0, 2.5});
  for (std::uint32_t i = 0; i < 6; ++i) {
    const std::uint32_t next = (i + 1) % 6;
    mesh.triangles.push_back({{i, i + 6, next + 6}, 0});
    mesh.triangles.push_back({{i, next + 6, next}, 0});
  }
  for (const auto& [a, b, c] :
       std::initializer_list<std::array<std::uint32_t, 3>>{{0, 1, 2}, {0, 2, 3}, {0, 3, 4}, {0, 4, 5}}) {
    mesh.triangles.push_back({{a, b, c}, 0});
    mesh.triangles.push_back({{a + 6, c + 6, b + 6}, 0});
  }
  return mesh;
}

TEST(MeshRoom, ACornerHidesWhatLiesBehindIt) {
  const Mesh mesh = l_room();
  EXPECT_TRUE(check(mesh).closed);
  EXPECT_FALSE(check(mesh).convex);
  const MeshSurfaces room(mesh, surfaces_of(mesh, 0.2));
  EXPECT_EQ(room.polygons(), 8u);
  const Vec3 near{5.5, 1, 1.2}, seen{1, 1.2, 1.2}, hidden{1, 5.5, 1.2};
  EXPECT_TRUE(room.is_indoors(near));
  EXPECT_FALSE(room.is_indoors({4, 5, 1.2}));
  const auto length_of_direct = [&](const Vec3& rx) {
    const auto paths = room.paths(near, rx, 0);
    return paths.empty() ? 0.0 : paths[0].length_m;
  };
  EXPECT_NEAR(length_of_direct(seen), glm::distance(near, seen), 1e-12);
  EXPECT_EQ(length_of_direct(hidden), 0);
  // By one bounce at x = 0 the hidden place is seen: the line from its image at x = -1 to (5.5, 1) meets x = 0 at y = 4.81,
  // and passes x = 3 at y = 2.73, below the corner at y = 3.
  const auto once = room.paths(near, hidden, 1);
  ASSERT_EQ(once.size(), 2u) << "... and by one at y = 0, since the room is the same across its diagonal";
  for (const StillPath& path : once) {
    const int axis = path.bounces[0].normal == Vec3{1, 0, 0} ? 0 : 1;
    EXPECT_NEAR(path.points[1][axis], 0, 1e-12);
    EXPECT_NEAR(path.points[1][1 - axis], 1 + 4.5 * 5.5 / 6.5, 1e-12);
    EXPECT_EQ(path.bounces[0].normal[axis], 1);
  }
}

TEST(MeshRoom, AScreenBlocksAndReflectsOnBothSides) {
  const Body screen = [] {
    Body b;
    b.shape = Shape::box;
    b.centre = {0, 0, 1};
    b.half_m = {0.01, 1, 1};
    return b;
  }();
  Mesh mesh = mesh_of(screen, 5);
  mesh.materials = {"metal"};
  const MeshSurfaces room(mesh, surfaces_of(mesh, 0));
  EXPECT_TRUE(room.paths({-2, 0.1, 1}, {2, 0.2, 1.1}, 0).empty());
  const auto one = room.paths({-2, 0.1, 1}, {-2, -0.4, 1.3}, 1);
  ASSERT_EQ(one.size(), 2u);
  EXPECT_NEAR(one[1].points[1].x, -0.01, 1e-12);
  EXPECT_EQ(one[1].bounces[0].normal, (Vec3{-1, 0, 0}));
}

TEST(Chains, AreCounted) {
  EXPECT_EQ(chains_of(6, 0), 1);
  EXPECT_EQ(chains_of(6, 1), 7);
  EXPECT_EQ(chains_of(6, 3), 1 + 6 + 30 + 150);
}

}  // namespace
}  // namespace csipose::sim
