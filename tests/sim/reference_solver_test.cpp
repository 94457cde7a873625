#include "sim/reference_solver.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <map>

#include "proto/npy.h"
#include "sim/scene_file.h"
#include "tests/sim/golden_scene.h"
#include "tests/sim/mixed_scene.h"

namespace csipose::sim {
namespace {
using Complex = std::complex<double>;

double rms(const std::vector<Complex>& h) {
  double sum = 0;
  for (const Complex& x : h) sum += std::norm(x);
  return std::sqrt(sum / static_cast<double>(h.size()));
}

TEST(SceneA, MeetsTheGoldenChannel) {
  CSIPOSE_NEEDS_SHARED_DATA();
  const Scene scene = read_scene(testing::shared_data("sim/scene_a.json"));
  const auto golden = read_npy<Complex>(testing::shared_data("sim/scene_a_H.npy"));
  ASSERT_EQ(golden.shape, (NpyShape{20, 30, 3, 3}));
  std::vector<Complex> error = solve_reference(scene);
  ASSERT_EQ(error.size(), golden.data.size());
  double worst = 0;
  for (std::size_t i = 0; i < error.size(); ++i)
    worst = std::max(worst, std::abs(error[i] -= golden.data[i]));
  EXPECT_LT(rms(error) / rms(golden.data), 1e-5);
  EXPECT_LT(worst / rms(golden.data), 1e-4);
}

TEST(SceneA, MeetsTheGoldenPathsOneByOne) {
  CSIPOSE_NEEDS_SHARED_DATA();
  const Scene scene = read_scene(testing::shared_data("sim/scene_a.json"));
  const auto paths = reference_paths(scene, scene.receivers[0][0], 0);
  const auto golden = testing::golden_list("scene_a.json", "paths_t0_rx0_ant0");
  ASSERT_EQ(paths.size(), golden.size());
  for (std::size_t i = 0; i < paths.size(); ++i) {
    SCOPED_TRACE(golden[i].dump());
    const Path& path = paths[i];
    EXPECT_EQ(path.body, golden[i]["type"] == "wall" ? -1 : golden[i]["body"].get<int>());
    if (path.body >= 0) {
      EXPECT_EQ(path.wall_before, golden[i]["pair"][0].get<int>());
      EXPECT_EQ(path.wall_after, golden[i]["pair"][1].get<int>());
    }
    EXPECT_NEAR(path.length_m, golden[i]["len"].get<double>(), 1e-8);
    EXPECT_LT(std::abs(path.amplitude - testing::complex_number(golden[i]["a"])), 2e-8);
    EXPECT_LT(std::abs(path.shadow - testing::complex_number(golden[i]["F"])), 2e-5);
  }
}

Complex at_carrier(const Scene& scene, std::size_t r, std::size_t a, double t_s) {
  return transfer(reference_paths(scene, scene.receivers[r][a], t_s), scene.carrier_hz);
}

/// Over subcarriers and antennas at time 0: what small is measured against, since a single entry may lie in a
/// fade.
double level(Scene scene) {
  scene.snapshots = 1;
  return rms(solve_reference(scene));
}

// Bodies move, nothing flickers: the channel has no step and no kink, however finely one looks.
TEST(MixedScene, IsSmoothInTime) {
  const Scene scene = mixed_scene();
  std::vector<Complex> h;
  for (int m = 0; m < scene.snapshots; ++m) h.push_back(at_carrier(scene, 0, 1, m * scene.step_s));
  double worst = 0;
  for (std::size_t m = 1; m + 1 < h.size(); ++m)
    worst = std::max(worst, std::abs(h[m - 1] - 2.0 * h[m] + h[m + 1]));
  EXPECT_LT(worst, 1e-3 * level(scene));
}

TEST(MixedScene, NoPathComesOrGoesAtOnce) {
  const Scene scene = mixed_scene();
  using Name = std::array<int, 7>;
  std::map<Name, std::vector<double>> strengths;  // by path, over time; 0 where it is not there
  for (int m = 0; m < scene.snapshots; ++m)
    for (const Path& p : reference_paths(scene, scene.receivers[0][1], m * scene.step_s)) {
      const Name name{p.image.x, p.image.y, p.image.z, p.body, p.wall_before, p.wall_after, p.face};
      auto& course = strengths.try_emplace(name, scene.snapshots).first->second;
      course[static_cast<std::size_t>(m)] = std::abs(p.amplitude * p.shadow);
    }
  const double whole = level(scene);
  for (const auto& [name, course] : strengths)
    for (std::size_t m = 1; m + 1 < course.size(); ++m)
      EXPECT_LT(std::abs(course[m - 1] - 2 * course[m] + course[m + 1]), 1e-3 * whole);
}

TEST(MixedScene, IsNearlyReciprocal) {
  Scene there = mixed_scene(), back = there;
  std::swap(back.transmitter, back.receivers[0][1]);
  const Complex a = at_carrier(there, 0, 1, 0), b = at_carrier(back, 0, 1, 0);
  EXPECT_LT(std::abs(a - b), 2e-2 * level(there));
}

TEST(MixedScene, ReceivesLessThanWasSent) {
  const Scene scene = mixed_scene();
  for (std::size_t r = 0; r < 2; ++r)
    for (std::size_t a = 0; a < 3; ++a) EXPECT_LT(std::norm(at_carrier(scene, r, a, 0)), 1);
}

// Wall - body - wall paths are many and weak.
TEST(MixedScene, FortyNinePairsContainTheThirteen) {
  Scene scene = mixed_scene();
  const auto few = reference_paths(scene, scene.receivers[0][0], 0);
  scene.pairs = 49;
  const auto many = reference_paths(scene, scene.receivers[0][0], 0);
  EXPECT_GT(many.size(), few.size());
  const auto both = std::count_if(many.begin(), many.end(),
                                  [](const Path& p) { return p.wall_before >= 0 && p.wall_after >= 0; });
  EXPECT_EQ(many.size(), few.size() + static_cast<std::size_t>(both));
  EXPECT_LT(std::abs(transfer(many, 5.64e9) - transfer(few, 5.64e9)), 0.2 * level(scene));
}

}  // namespace
}  // namespace csipose::sim
