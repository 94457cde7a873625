// Bodies as triangles: physical optics agrees with the analytic bodies, mirrors of triangles do not.
#include "sim/facet_solver.h"

#include <fmt/format.h>
#include <gtest/gtest.h>

#include <cmath>
#include <fstream>
#include <numbers>

#include "proto/result.h"
#include "sim/material.h"
#include "sim/mesh_scene.h"
#include "sim/reference_solver.h"
#include "sim/scene_file.h"
#include "sim/shadow.h"

namespace csipose::sim {
namespace {
using Complex = std::complex<double>;

/// One antenna at either end, three metres and more apart, the body beside the line between them.
Scene open_scene(const std::string& body) {
  return parse_scene(
      R"({"tx": [0, 0, 1], "antennas": 1, "snapshots": 1, "pattern": "hw_dipole", "subcarriers": [-28, 0, 28],
    "rx": [{"center": [3.6, 0.4, 1.2]}], "bodies": [)" +
          body + "]}",
      "s.json");
}

struct Compared {
  double error, scattered;  ///< of the channel; of what the body scatters; greatest over tones
};
Compared compare(const Scene& scene, Scatter scatter) {
  const Antenna& rx = scene.receivers[0][0];
  const auto paths = reference_paths(scene, rx, 0);
  const auto facets = facet_channel(scene, solids_of(scene, 0), rx, scatter);
  Compared found{0, 0};
  for (std::size_t k = 0; k < scene.tones.size(); ++k) {
    const double hz = scene.carrier_hz + scene.tones[k] * kToneSpacing_hz;
    found.error = std::max(found.error, std::abs(facets[k] - transfer(paths, hz)));
    found.scattered = std::max(found.scattered, std::abs(transfer({paths.begin() + 1, paths.end()}, hz)));
  }
  return found;
}

TEST(TriangleMean, IsThatOfManyPoints) {
  for (const auto& [p, q] :
       {std::pair{0.3, -2.1}, {5.0, 5.0}, {-4.0, 0.0}, {0.0, 7.0}, {1e-5, -2e-5}, {3.0, 3.0 + 1e-7}}) {
    Complex sum = 0;
    int count = 0;
    constexpr int kSteps = 400;
    for (int i = 0; i < kSteps; ++i)  // middles of small triangles, both ways up
      for (int j = 0; i + j < kSteps; ++j)
        for (const double third : {1 / 3.0, 2 / 3.0}) {
          if (third > 0.5 && i + j + 1 >= kSteps) continue;
          sum += std::polar(1.0, -((i + third) * p + (j + third) * q) / kSteps);
          ++count;
        }
    EXPECT_LT(std::abs(triangle_mean(p, q) - sum / double(count)), 1e-4) << p << " " << q;
  }
}

TEST(PhysicalOptics, AgreesWithAnalyticBodiesSeenFromNearTheSource) {
  for (
      const char* body :
      {R"({"kind": "sphere", "c": [3.0, 0.9, 1.1], "r": 0.3, "mat": "skin_dry"})",
       R"({"kind": "sphere", "c": [2.2, -1.6, 0.9], "r": 0.2, "mat": "metal"})",
       R"({"kind": "ellipsoid", "c": [2.7, 1.3, 1.1], "axes": [0.35, 0.25, 0.3], "q": [0.1, 0.3, 0.2, 0.9], "mat": "skin_dry"})"}) {
    Scene scene = open_scene(body);
    scene.receivers[0][0].position = {-0.1, 0.5, 1.2};
    const Compared found = compare(scene, Scatter::po);
    EXPECT_LT(found.error, 0.05 * found.scattered) << body;
  }
}

TEST(PhysicalOptics, AgreesToAFewPercentOfTheLineOfSightAnywhere) {
  // Far from the source the edge of the lit part adds to physical optics what no smooth body does.
  for (
      const char* body :
      {R"({"kind": "sphere", "c": [1.7, 1.4, 1.1], "r": 0.3, "mat": "skin_dry"})",
       R"({"kind": "ellipsoid", "c": [1.7, 1.3, 1.1], "axes": [0.35, 0.25, 0.3], "q": [0.1, 0.3, 0.2, 0.9], "mat": "skin_dry"})",
       R"({"kind": "cylinder", "c": [1.7, 1.5, 1.1], "r": 0.2, "hh": 0.4, "mat": "skin_dry"})"}) {
    const Scene scene = open_scene(body);
    const Antenna& rx = scene.receivers[0][0];
    EXPECT_LT(compare(scene, Scatter::po).error, 0.05 * std::abs(reference_paths(scene, rx, 0)[0].amplitude))
        << body;
  }
}

TEST(PhysicalOptics, AgreesOnAPlateThatHoldsTheMirrorPoint) {
  const Compared found =
      compare(open_scene(R"({"kind": "box", "c": [1.8, 1.6, 1.1], "h": [0.5, 0.05, 0.5], "mat": "metal"})"),
              Scatter::po);
  EXPECT_LT(found.error, 0.05 * found.scattered);
}

TEST(HullShadow, IsThatOfTheBody) {
  Body body;
  body.centre = {1.8, 0.3, 1.1};
  const Leg leg{{0, 0, 1}, {3.6, 0.4, 1.2}, 0, glm::distance(Vec3{0, 0, 1}, Vec3{3.6, 0.4, 1.2})};
  for (const auto& [shape, half] : {std::pair{Shape::ellipsoid, Vec3{0.3, 0.2, 0.25}},
                                    {Shape::box, Vec3{0.2, 0.1, 0.3}},
                                    {Shape::cylinder, Vec3{0.15, 0.15, 0.3}}}) {
    body.shape = shape;
    body.half_m = half;
    const Complex analytic = shadow_factor(body, leg, 0.0531547),
                  hull = hull_shadow_factor(mesh_of(body, 0.02).points, leg, 0.0531547);
    EXPECT_LT(std::abs(analytic - 1.0), 2) << "in the way";
    EXPECT_GT(std::abs(analytic - 1.0), 0.1);
    EXPECT_LT(std::abs(hull - analytic), 0.02);
  }
}

TEST(Facets, AreMirrorsAndHideAll) {
  const Compared mirror =
      compare(open_scene(R"({"kind": "box", "c": [1.8, 1.6, 1.1], "h": [1.5, 0.05, 1.5], "mat": "metal"})"),
              Scatter::facet);
  EXPECT_LT(mirror.error, 0.15 * mirror.scattered) << "a plate thirty wavelengths across is nearly a wall";
  const Scene hidden = open_scene(R"({"kind": "sphere", "c": [1.8, 0.2, 1.1], "r": 0.2, "mat": "metal"})");
  for (const Complex& h : facet_channel(hidden, solids_of(hidden, 0), hidden.receivers[0][0], Scatter::facet))
    EXPECT_EQ(h, 0.0);
}

/// Greatest second difference in time over the rms.
double flicker(const std::vector<Complex>& h) {
  double worst = 0, power = 0;
  for (std::size_t t = 0; t < h.size(); ++t) {
    power += std::norm(h[t]) / double(h.size());
    if (t > 1) worst = std::max(worst, std::abs(h[t] - 2.0 * h[t - 1] + h[t - 2]));
  }
  return worst / std::sqrt(power);
}

TEST(Facets, FlickerWherePhysicsIsSmooth) {
  Scene scene = open_scene(
      R"({"kind": "sphere", "c": [1.8, 0.52, 1.1], "r": 0.3, "mat": "skin_dry", "v": [0.5, -1, 0.2]})");
  scene.tones = {0};
  scene.snapshots = 16;
  scene.step_s = 1 / 300.0;
  const double facet = flicker(solve_facets(scene, Scatter::facet)),
               po = flicker(solve_facets(scene, Scatter::po)), analytic = flicker(solve_reference(scene));
  RecordProperty("flicker", fmt::format("facet {:.4f} po {:.4f} analytic {:.4f}", facet, po, analytic));
  EXPECT_GT(facet, 3 * analytic);
  EXPECT_LT(po, 1.5 * analytic);
}

class MeshFiles : public ::testing::Test {
 protected:
  void SetUp() override {
    std::string pattern = (std::filesystem::temp_directory_path() / "csipose-mesh-XXXXXX").string();
    ASSERT_NE(mkdtemp(pattern.data()), nullptr);
    folder_ = pattern;
  }
  void TearDown() override { std::filesystem::remove_all(folder_); }
  void write_obj(const char* name, const Mesh& mesh, const std::string& material) {
    std::ofstream out(folder_ / name);
    out.precision(17);
    for (const Vec3& p : mesh.points) out << "v " << p.x << ' ' << p.y << ' ' << p.z << '\n';
    if (!material.empty()) out << "usemtl " << material << '\n';
    for (const auto& t : mesh.triangles)
      out << "f " << t.corners[0] + 1 << ' ' << t.corners[1] + 1 << ' ' << t.corners[2] + 1 << '\n';
  }
  Scene read(const std::string& text) {
    std::ofstream(folder_ / "s.json") << text;
    return read_scene_with_meshes(folder_ / "s.json");
  }
  std::string refusal(const std::string& text) {
    try {
      read(text);
    } catch (const SetupError& error) {
      return error.what();
    }
    return "accepted";
  }
  std::filesystem::path folder_;
};

constexpr const char* kEnds =
    R"("tx": [0.5, 0.5, 1], "antennas": 1, "snapshots": 1, "rx": [{"center": [3.6, 0.9, 1.2]}])";

TEST_F(MeshFiles, ABodyFromAFileScattersLikeTheSolidItWasMadeFrom) {
  Body ball;
  ball.half_m = Vec3{0.3};
  write_obj("ball.obj", mesh_of(ball, 0.03), "Skin.001");
  const Scene scene =
      read(std::string("{") + kEnds +
           R"(, "bodies": [{"kind": "mesh", "file": "ball.obj", "c": [2, 2, 1.1], "mat": "skin_dry"}]})");
  const Scene solid =
      parse_scene(std::string("{") + kEnds +
                      R"(, "bodies": [{"kind": "sphere", "r": 0.3, "c": [2, 2, 1.1], "mat": "skin_dry"}]})",
                  "s");
  const auto h = solve_facets(scene, Scatter::po), expected = solve_reference(solid);
  const auto paths = reference_paths(solid, solid.receivers[0][0], 0);
  ASSERT_EQ(paths.size(), 2u);
  for (std::size_t k = 0; k < h.size(); ++k)
    EXPECT_LT(std::abs(h[k] - expected[k]), 0.05 * std::abs(paths[0].amplitude));
}

TEST_F(MeshFiles, ARoomFromAFileIsTheShoeboxItWasMadeFrom) {
  Room room;
  room.size_m = {4.2, 3.7, 2.6};
  Mesh mesh = mesh_of(room, {"brick", "brick", "brick", "brick", "brick", "brick"});
  write_obj("room.obj", mesh, "brick");
  std::string materials;
  for (const char* wall : {"x0", "x1", "y0", "y1", "z0", "z1"})
    materials += fmt::format(R"({}"{}": {{"name": "brick"}})", materials.empty() ? "" : ",", wall);
  const Scene from_file = read(std::string("{") + kEnds + R"(, "meshes": [{"file": "room.obj"}]})");
  const Scene shoebox = parse_scene(
      std::string("{") + kEnds + R"(, "L": [4.2, 3.7, 2.6], "materials": {)" + materials + "}}", "s");
  const auto h = solve_reference(from_file), expected = solve_reference(shoebox);
  for (std::size_t k = 0; k < h.size(); ++k)
    EXPECT_LT(std::abs(h[k] - expected[k]), 1e-9 * std::abs(expected[k]));
}

TEST_F(MeshFiles, FurnitureInAShoeboxHidesAndReflects) {
  Body cabinet;
  cabinet.shape = Shape::box;
  cabinet.centre = {2, 0.7, 1};
  cabinet.half_m = {0.2, 0.3, 0.9};
  write_obj("cabinet.obj", mesh_of(cabinet, 5), "Steel");
  const std::string room =
      R"(, "L": [4, 3, 2.6], "order": 1, "materials": {"x0": {"name": "wood"}, "x1": {"name": "wood"}, "y0": {"name": "wood"},
    "y1": {"name": "wood"}, "z0": {"name": "wood"}, "z1": {"name": "wood"}})";
  const Scene scene = read(std::string("{") + kEnds + room +
                           R"(, "meshes": [{"file": "cabinet.obj", "materials": {"Steel": "metal"}}]})");
  for (const Path& path : reference_paths(scene, scene.receivers[0][0], 0))
    EXPECT_GT(path.legs.size(), 1u) << "the cabinet stands between";
  EXPECT_NE(refusal(std::string("{") + kEnds + room + R"(, "meshes": [{"file": "cabinet.obj"}]})")
                .find("no material 'Steel'"),
            std::string::npos);
}

TEST_F(MeshFiles, AreRefusedInWords) {
  Body box;
  box.shape = Shape::box;
  box.half_m = {0.2, 0.3, 0.9};
  Mesh open = mesh_of(box, 5);
  open.triangles.pop_back();
  write_obj("open.obj", open, "");
  const std::string body =
      std::string("{") + kEnds +
      R"(, "bodies": [{"kind": "mesh", "file": "open.obj", "c": [2, 2, 1.1], "mat": "wood"}]})";
  EXPECT_NE(refusal(body).find("open.obj: is open"), std::string::npos) << refusal(body);
  const std::string room = std::string("{") + kEnds + R"(, "meshes": [{"file": "open.obj", "mat": "wood"}]})";
  EXPECT_NE(refusal(room).find("no floor below"), std::string::npos) << refusal(room);
  Body ball;
  ball.half_m = Vec3{5};
  write_obj("ball.obj", mesh_of(ball, 0.5), "wood");
  const std::string round = std::string("{") + kEnds + R"(, "meshes": [{"file": "ball.obj"}]})";
  EXPECT_NE(refusal(round).find("too many paths of 3 bounces"), std::string::npos) << refusal(round);
  EXPECT_NE(refusal(std::string("{") + kEnds + R"(, "meshes": [{"file": "none.obj"}]})")
                .find("cannot read the mesh"),
            std::string::npos);
}

}  // namespace
}  // namespace csipose::sim
