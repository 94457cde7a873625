#include "sim/room.h"

#include <gtest/gtest.h>

#include <cmath>
#include <map>
#include <random>

#include "sim/geometry.h"
#include "sim/material.h"
#include "sim/reference_solver.h"
#include "tests/sim/golden.h"
#include "tests/sim/golden_scene.h"

namespace csipose::sim {
namespace {
using Complex = std::complex<double>;

Complex sum_paths(const std::vector<std::pair<double, Complex>>& paths, double frequency_hz) {
  Complex sum = 0;
  for (const auto& [length_m, gain] : paths)
    sum += gain / length_m * std::polar(1.0, -2 * kPi * frequency_hz * length_m / kSpeedOfLight_m_s);
  return sum;
}

void expect_channel(const std::function<Complex(double)>& h, const nlohmann::json& expected,
                    double relative) {
  const auto golden = testing::complex_list(expected);
  ASSERT_EQ(golden.size(), kSubcarriers);
  double rms = 0, error = 0;
  for (std::size_t k = 0; k < kSubcarriers; ++k) {
    rms += std::norm(golden[k]);
    error = std::max(error, std::abs(h(Band{}.frequency_hz(k)) - golden[k]));
  }
  EXPECT_LT(error, relative * std::sqrt(rms / kSubcarriers));
}

TEST(Friis, MeetsTheGoldenLinks) {
  CSIPOSE_NEEDS_SHARED_DATA();
  for (const auto& c : testing::golden_list("friis.json", "cases")) {
    Scene scene;
    scene.walls = false;
    const Pattern pattern = *find_pattern(c["pattern"].get<std::string>());
    scene.transmitter = {c.contains("tx") ? vec3(c["tx"]) : Vec3{0}, {0, 0, 1}, pattern};
    const Antenna rx{c.contains("rx") ? vec3(c["rx"]) : Vec3{c["d"].get<double>(), 0, 0}, {0, 0, 1}, pattern};
    const auto paths = reference_paths(scene, rx, 0);
    ASSERT_EQ(paths.size(), 1u);
    EXPECT_NEAR(std::abs(paths[0].amplitude) / c["amp"].get<double>(), 1, 1e-9);
    if (c.contains("H")) expect_channel([&](double f) { return transfer(paths, f); }, c["H"], 1e-9);
  }
}

// Direct and floor path only: images (0,0,0) and (0,0,-1).
void expect_two_ray(const nlohmann::json& c, double thickness_m, const char* te_key, const char* dipole_key) {
  const Vec3 tx{0, 0, c["ht"].get<double>()}, rx{c["d"].get<double>(), 0, c["hr"].get<double>()};
  const Surface floor{find_material(c["material"].get<std::string>())->permittivity(5.64e9), thickness_m};
  const double lambda_m = Band{}.wavelength_m(), direct_m = glm::distance(tx, rx);
  const Vec3 image{0, 0, -tx.z}, hit = image + tx.z / (tx.z + rx.z) * (rx - image);
  const double bounced_m = glm::distance(image, rx), cosine = (tx.z + rx.z) / bounced_m;
  const Complex te = floor.reflection(cosine, lambda_m).te;
  expect_channel(
      [&](double f) {
        return lambda_m / (4 * kPi) * sum_paths({{direct_m, 1.0}, {bounced_m, te}}, f);
      },
      c[te_key], 1e-9);

  const Antenna a{tx, {0, 0, 1}, Pattern::hw_dipole}, b{rx, {0, 0, 1}, Pattern::hw_dipole};
  const std::vector<Vec3> straight{tx, rx}, bent{tx, hit, rx};
  const std::vector<Bounce> bounce{{{0, 0, 1}, floor}};
  const Complex direct = field_gain(a, b, straight, {}, lambda_m),
                bounced = field_gain(a, b, bent, bounce, lambda_m);
  expect_channel(
      [&](double f) {
        return lambda_m / (4 * kPi) * sum_paths({{direct_m, direct}, {bounced_m, bounced}}, f);
      },
      c[dipole_key], 1e-9);
}

TEST(TwoRay, MeetsTheGoldenChannels) {
  CSIPOSE_NEEDS_SHARED_DATA();
  for (const auto& c : testing::golden_list("two_ray.json", "cases")) {
    expect_two_ray(c, c["thickness"].get<double>(), "iso_scalar_te_slab", "v_hw_dipole_slab");
    expect_two_ray(c, 0, "iso_scalar_te_halfspace", "v_hw_dipole_halfspace");
  }
}

double cosine_at(const WallPath& path, std::size_t i) {
  const Vec3 k = glm::normalize(path.points[i + 1] - path.points[i]);
  return -glm::dot(k, inward_normal(path.walls[i]));
}

/// A channel whose reflections are scalars.
template <class Coefficient>
std::function<Complex(double)> scalar_channel(std::vector<WallPath> paths, double lambda_m,
                                              const Coefficient& of) {
  return [paths = std::move(paths), lambda_m, of](double f) {
    std::vector<std::pair<double, Complex>> terms;
    for (const WallPath& path : paths) {
      Complex gain = lambda_m / (4 * kPi);
      for (std::size_t i = 0; i < path.walls.size(); ++i) gain *= of(path, i);
      terms.push_back({path.length_m, gain});
    }
    return sum_paths(terms, f);
  };
}

TEST(Shoebox, MeetsTheGoldenChannels) {
  CSIPOSE_NEEDS_SHARED_DATA();
  for (const auto& c : testing::golden_list("shoebox.json", "cases")) {
    Scene scene;
    scene.room = room_of(c);
    const Vec3 tx = vec3(c["tx"]), rx = vec3(c["rx"]);
    const double lambda_m = scene.wavelength_m();
    for (int order = 0; order <= 3; ++order) {
      SCOPED_TRACE(c["name"].get<std::string>() + " order " + std::to_string(order));
      const auto key = [&](const char* what) {
        return std::string("H_") + what + "_order" + std::to_string(order);
      };
      const auto paths = wall_paths(scene.room, tx, rx, order);
      expect_channel(
          scalar_channel(paths, lambda_m, [](const WallPath&, std::size_t) { return Complex(-0.6); }),
          c[key("const_beta_-0.6")], 1e-9);
      expect_channel(
          scalar_channel(
              paths, lambda_m,
              [&](const WallPath& path, std::size_t i) {
                return scene.room.surface(path.walls[i]).reflection(cosine_at(path, i), lambda_m).te;
              }),
          c[key("scalar_te")], 1e-9);
      scene.wall_order = order;
      for (const auto& [name, pattern] :
           {std::pair{"V_iso", Pattern::iso}, {"V_hw_dipole", Pattern::hw_dipole}}) {
        scene.transmitter = {tx, {0, 0, 1}, pattern};
        const auto full = reference_paths(scene, {rx, {0, 0, 1}, pattern}, 0);
        expect_channel([&](double f) { return transfer(full, f); }, c[key(name)], 1e-9);
      }
    }
  }
}

TEST(Shoebox, MeetsTheGoldenPathsOneByOne) {
  CSIPOSE_NEEDS_SHARED_DATA();
  for (const auto& c : testing::golden_list("shoebox.json", "cases")) {
    Scene scene;
    scene.room = room_of(c);
    scene.transmitter.position = vec3(c["tx"]);
    const auto paths = reference_paths(scene, {vec3(c["rx"]), {0, 0, 1}, Pattern::hw_dipole}, 0);
    const auto& golden = c["paths_hw_dipole"];
    ASSERT_EQ(paths.size(), golden.size());
    const double strongest = std::abs(paths[31].amplitude);
    for (std::size_t i = 0; i < paths.size(); ++i) {
      EXPECT_EQ((std::array{paths[i].image.x, paths[i].image.y, paths[i].image.z}),
                (golden[i]["idx"].get<std::array<int, 3>>()));
      std::vector<std::string> walls;
      for (const Wall wall : paths[i].walls) walls.emplace_back(kWallNames[static_cast<std::size_t>(wall)]);
      EXPECT_EQ(walls, golden[i]["walls"].get<std::vector<std::string>>());
      EXPECT_NEAR(paths[i].length_m, golden[i]["len"].get<double>(), 1e-9);
      EXPECT_LT(std::abs(paths[i].amplitude - testing::complex_number(golden[i]["a"])), 1e-9 * strongest);
    }
  }
}

TEST(WallPaths, AreAsManyAsImagesAndAsLongAsTheirLegs) {
  const Room room{{5, 4, 3}, {}};
  std::mt19937 random(1);
  std::uniform_real_distribution<double> part(0.05, 0.95);
  for (int trial = 0; trial < 50; ++trial) {
    const auto point = [&] { return room.size_m * Vec3{part(random), part(random), part(random)}; };
    const Vec3 tx = point(), rx = point();
    for (const auto& [order, count] : {std::pair{0, 1u}, {1, 7u}, {2, 25u}, {3, 63u}})
      ASSERT_EQ(wall_paths(room, tx, rx, order).size(), count);
    for (const WallPath& path : wall_paths(room, tx, rx, 3)) {
      double length_m = 0;
      for (std::size_t i = 0; i + 1 < path.points.size(); ++i)
        length_m += glm::distance(path.points[i], path.points[i + 1]);
      ASSERT_NEAR(length_m, path.length_m, 1e-9);
      for (std::size_t i = 0; i < path.walls.size(); ++i) {  // on its wall, and mirrored there
        const Vec3 k = glm::normalize(path.points[i + 1] - path.points[i]);
        const Vec3 next = glm::normalize(path.points[i + 2] - path.points[i + 1]);
        ASSERT_NEAR(path.points[i + 1][axis_of(path.walls[i])], plane_of(room, path.walls[i]), 1e-9);
        ASSERT_LT(glm::distance(mirrored(k, inward_normal(path.walls[i])), next), 1e-9);
      }
    }
  }
}

// Swapping transmitter and receiver changes nothing in a room without bodies.
TEST(Shoebox, IsReciprocal) {
  Scene scene;
  scene.room.size_m = {5.2, 4.1, 2.9};
  const char* names[] = {"concrete", "plasterboard", "glass", "wood", "brick", "ceiling_board"};
  for (std::size_t w = 0; w < kWalls; ++w)
    scene.room.walls[w] = {find_material(names[w])->permittivity(5.64e9), find_material(names[w])->slab_m};
  const Antenna a{{0.1, 2.3, 1.2}, glm::normalize(Vec3{0.1, 0, 1}), Pattern::hw_dipole};
  const Antenna b{{4.4, 1.0, 1.6}, {0, 0, 1}, Pattern::hw_dipole};
  scene.transmitter = a;
  const Complex there = transfer(reference_paths(scene, b, 0), 5.64e9);
  scene.transmitter = b;
  const Complex back = transfer(reference_paths(scene, a, 0), 5.64e9);
  EXPECT_LT(std::abs(there - back), 1e-12);
}

}  // namespace
}  // namespace csipose::sim
