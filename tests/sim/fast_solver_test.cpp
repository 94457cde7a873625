#include "sim/fast_solver.h"

#include <gtest/gtest.h>

#include <cmath>
#include <numbers>

#include "proto/npy.h"
#include "sim/fast_optics.h"
#include "sim/reference_solver.h"
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

std::vector<Complex> difference(const std::vector<std::complex<float>>& a, const std::vector<Complex>& b) {
  std::vector<Complex> d(a.size());
  for (std::size_t i = 0; i < a.size(); ++i) d[i] = Complex(a[i]) - b[i];
  return d;
}

/// What is left of H[snapshot]... when each entry's mean over the snapshots is taken away.
std::vector<Complex> moving_part(std::vector<Complex> h, std::size_t snapshots) {
  const std::size_t entries = h.size() / snapshots;
  for (std::size_t i = 0; i < entries; ++i) {
    Complex mean = 0;
    for (std::size_t t = 0; t < snapshots; ++t) mean += h[t * entries + i] / static_cast<double>(snapshots);
    for (std::size_t t = 0; t < snapshots; ++t) h[t * entries + i] -= mean;
  }
  return h;
}

void expect_close(const std::vector<std::complex<float>>& fast, const std::vector<Complex>& truth,
                  int snapshots) {
  ASSERT_EQ(fast.size(), truth.size());
  const auto error = difference(fast, truth);
  const auto count = static_cast<std::size_t>(snapshots);
  EXPECT_LT(rms(error) / rms(truth), 1e-2);
  EXPECT_LT(rms(moving_part(error, count)) / rms(moving_part(truth, count)), 3e-2);
}

TEST(FastSolver, MeetsTheGoldenScene) {
  CSIPOSE_NEEDS_SHARED_DATA();
  const Scene scene = read_scene(testing::shared_data("sim/scene_a.json"));
  const auto golden = read_npy<Complex>(testing::shared_data("sim/scene_a_H.npy"));
  expect_close(solve_fast(scene), golden.data, scene.snapshots);
}

// What stands still may be furniture: the same physics, made once.
TEST(FastSolver, FurnitureIsABodyThatStandsStill) {
  Scene moving = mixed_scene();
  moving.step_s = 1 / 300.0;
  moving.snapshots = 20;
  moving.bodies[1].velocity_m_s = moving.bodies[3].velocity_m_s = Vec3{0};
  Scene furnished = moving;
  for (const std::size_t i : {3u, 1u}) {
    furnished.furniture.push_back(moving.bodies[i].start);
    furnished.bodies.erase(furnished.bodies.begin() + static_cast<std::ptrdiff_t>(i));
  }
  const auto truth = solve_reference(moving), same = solve_reference(furnished);
  double largest = 0;
  for (std::size_t i = 0; i < truth.size(); ++i) largest = std::max(largest, std::abs(truth[i] - same[i]));
  EXPECT_LT(largest, 1e-12 * rms(truth) * 1e2) << "the order of sums differs, no more";
  expect_close(solve_fast(furnished), truth, furnished.snapshots);
}

// The same arithmetic in registers of other widths.
TEST(FastSolver, AgreesWithTheReferenceAndWithItselfOnEveryInstructionSet) {
  Scene scene = mixed_scene();
  scene.step_s = 1 / 300.0;
  scene.snapshots = 20;
  const auto truth = solve_reference(scene);
  const auto plain = solve_fast(scene, *find_kernels("plain"));
  expect_close(plain, truth, scene.snapshots);
  const std::vector<Complex> as_double(plain.begin(), plain.end());
  for (const char* name : {"avx2", "avx512"})
    if (const FastKernels* kernels = find_kernels(name)) {
      EXPECT_LT(rms(difference(solve_fast(scene, *kernels), as_double)) / rms(truth), 1e-5) << name;
    }
}

// Without bodies nothing is approximated but the numbers.
TEST(FastSolver, WallsAloneAgreeToFloatRounding) {
  Scene scene = mixed_scene();
  scene.bodies.clear();
  scene.snapshots = 1;
  const auto truth = solve_reference(scene);
  EXPECT_LT(rms(difference(solve_fast(scene), truth)) / rms(truth), 1e-5);
}

// Devices that mirror each other in the room's middle: some paths meet two walls in one point, in an edge of the room.
TEST(FastSolver, APathThroughAnEdgeOfTheRoomIsLikeItsNeighbours) {
  Scene scene = mixed_scene();
  const Vec3 size = scene.room.size_m;
  scene.snapshots = 1;
  scene.transmitter.position = {0.6, size.y / 2, 1.2};
  scene.receivers = {{{{size.x - 0.6, size.y / 2, 1.2}}}};
  Body desk;  // with faces whose planes meet the walls there too
  desk.shape = Shape::box;
  desk.centre = {1.0, 1.0, 0.73};
  desk.half_m = {0.3, 0.6, 0.015};
  scene.furniture = {desk};
  const auto exactly = solve_reference(scene);
  EXPECT_LT(rms(difference(solve_fast(scene), exactly)) / rms(exactly), 1e-2);
  scene.receivers[0][0].position.y += 1e-6;
  const auto beside = solve_reference(scene);
  for (std::size_t k = 0; k < exactly.size(); ++k)
    EXPECT_LT(std::abs(exactly[k] - beside[k]), 1e-2 * rms(beside));
}

TEST(FastSolver, MeetsTheGoldenBodies) {
  CSIPOSE_NEEDS_SHARED_DATA();
  const auto expect_body = [](const nlohmann::json& c, const Body& body, const char* key, double tolerance) {
    Scene scene;
    scene.walls = false;
    scene.transmitter.position = vec3(c["tx"]);
    scene.receivers = {{{vec3(c["rx"])}}};
    scene.bodies = {{body, {}}};
    scene.tones = intel5300_tones();
    const auto golden = testing::complex_list(c[key]);
    EXPECT_LT(rms(difference(solve_fast(scene), golden)) / rms(golden), tolerance);
  };
  for (const auto& c : testing::golden_list("sphere.json", "cases"))
    expect_body(c, sphere(vec3(c["c"]), c["radius"].get<double>(), "skin_dry"), "H_skin_hw_dipole", 5e-3);
  for (const auto& c : testing::golden_list("bodies.json", "cases"))
    expect_body(c, body_of(c), "H_hw_dipole", 1e-2);
}

/// The reflection where the kernel finds it.
std::optional<Reflection> kernel_reflection(const Body& body, const Vec3& tx, const Vec3& rx) {
  const Vec3 s = tx - body.centre, q = rx - body.centre;
  const Mat3 stretch = stretch_of(body);
  EllipsoidLanes lanes{};
  for (std::size_t lane = 0; lane < 16; ++lane) {
    lanes.sx[lane] = static_cast<float>(s.x), lanes.sy[lane] = static_cast<float>(s.y);
    lanes.sz[lane] = static_cast<float>(s.z), lanes.qx[lane] = static_cast<float>(q.x);
    lanes.qy[lane] = static_cast<float>(q.y), lanes.qz[lane] = static_cast<float>(q.z);
    for (int i = 0; i < 9; ++i) lanes.j[i][lane] = static_cast<float>(stretch[i / 3][i % 3]);
  }
  best_kernels().ellipsoids(lanes);
  return ellipsoid_reflection(body, glm::normalize(Vec3{lanes.ux[0], lanes.uy[0], lanes.uz[0]}), tx, rx);
}

TEST(FastSolver, KernelsMeetTheGoldenCrossSections) {
  CSIPOSE_NEEDS_SHARED_DATA();
  for (const auto& c : testing::golden_list("rcs.json", "cases"))
    for (const auto& g : c["go_bistatic"]) {
      const double angle = g["bistatic_deg"].get<double>() * std::numbers::pi / 180;
      const auto found = kernel_reflection(sphere({0, 0, 0}, c["radius"].get<double>(), "metal"),
                                           {1000, 0, 0}, {1000 * std::cos(angle), 1000 * std::sin(angle), 0});
      ASSERT_TRUE(found.has_value());
      const double scattered = std::abs(found->spreading) * found->s1_m * found->s2_m;
      EXPECT_NEAR(4 * std::numbers::pi * scattered * scattered / g["sigma"].get<double>(), 1, 3e-3);
    }
}

// What the sum above is made of: the reflection's spreading and the shadow, each by its kernel.
TEST(FastSolver, KernelsMeetTheGoldenSpheres) {
  CSIPOSE_NEEDS_SHARED_DATA();
  const double lambda_m = Scene{}.wavelength_m();
  FastOptics optics(best_kernels(), lambda_m);
  for (const auto& c : testing::golden_list("sphere.json", "cases")) {
    const Body body = sphere(vec3(c["c"]), c["radius"].get<double>(), "skin_dry");
    const Vec3 tx = vec3(c["tx"]), rx = vec3(c["rx"]);
    BodyTable table;
    table.assign(std::array{body_row(body)});
    optics.begin_shadows(1);
    optics.add_shadows(leg_row({tx, rx, 0, glm::distance(tx, rx)}), table, -1, 0);
    const std::complex<double> shadow(optics.take_shadows()[0]);
    EXPECT_LT(std::abs(shadow - testing::complex_number(c["F_leg"])), 2e-3);
    if (!c.contains("A")) continue;
    const auto reflection = kernel_reflection(body, tx, rx);
    ASSERT_TRUE(reflection.has_value());
    EXPECT_NEAR(std::abs(reflection->spreading) / c["A"].get<double>(), 1, 1e-3);
  }
}

TEST(FastSolver, MeetsTheGoldenLinksAndRooms) {
  CSIPOSE_NEEDS_SHARED_DATA();
  const auto expect_channel = [](const Scene& scene, const nlohmann::json& golden, double tolerance) {
    const auto truth = testing::complex_list(golden);
    EXPECT_LT(rms(difference(solve_fast(scene), truth)) / rms(truth), tolerance);
  };
  for (const auto& c : testing::golden_list("shoebox.json", "cases"))
    for (int order = 0; order <= 3; ++order)
      for (const auto& [name, pattern] :
           {std::pair{"V_iso", Pattern::iso}, {"V_hw_dipole", Pattern::hw_dipole}}) {
        Scene scene;
        scene.room = room_of(c);
        scene.transmitter = {vec3(c["tx"]), {0, 0, 1}, pattern};
        scene.receivers = {{{vec3(c["rx"]), {0, 0, 1}, pattern}}};
        scene.tones = intel5300_tones();
        scene.wall_order = order;
        expect_channel(scene, c[std::string("H_") + name + "_order" + std::to_string(order)], 1e-4);
      }
}

// A ball's Doppler shift, read from the phase of what the fast path adds to the empty space.
TEST(FastSolver, MeetsTheGoldenDopplerRates) {
  CSIPOSE_NEEDS_SHARED_DATA();
  for (const auto& c : testing::golden_list("doppler.json", "cases")) {
    Scene scene;
    scene.walls = false;
    scene.pairs = 1;
    scene.transmitter = {vec3(c["tx"]), {0, 0, 1}, Pattern::iso};
    scene.receivers = {{{vec3(c["rx"]), {0, 0, 1}, Pattern::iso}}};
    scene.tones = {0};
    scene.snapshots = 20;
    scene.step_s = 0.0025;
    const auto empty = solve_fast(scene);
    const Vec3 velocity = c["v"].is_array() ? vec3(c["v"]) : Vec3{-c["v"].get<double>(), 0, 0};
    scene.bodies = {{sphere(vec3(c["c0"]), c["radius"].get<double>(), "metal"), velocity}};
    const auto h = solve_fast(scene);
    // Turns from snapshot to snapshot add up; a line is fitted as the golden value's was.
    double turns = 0, xy = 0, xx = 0;
    for (std::size_t m = 0; m < h.size(); ++m) {
      if (m > 0) turns += std::arg((h[m] - empty[m]) / (h[m - 1] - empty[m - 1])) / (2 * std::numbers::pi);
      const double x = static_cast<double>(m) - 9.5;
      xy += x * turns, xx += x * x;
    }
    EXPECT_NEAR(xy / xx / scene.step_s, c["phase_rate_hz"].get<double>(), 0.05);
  }
}

// A body's path is solved at the middle of an array: how far off is what its outer antennas see?
TEST(FastSolver, ArraysAreAsNearlyFlatAsTheGoldenBoundSays) {
  CSIPOSE_NEEDS_SHARED_DATA();
  const double wave_number = 2 * std::numbers::pi / Scene{}.wavelength_m();
  for (const auto& c : testing::golden_list("array_bound.json", "cases")) {
    const double distance = c["source_distance"].get<double>(), offset = c["element_offset"].get<double>();
    double flat = 0, bent = 0;
    for (int i = 0; i <= 1800; ++i) {
      const double angle = std::numbers::pi * i / 1800, along = offset * std::cos(angle);
      const double exact = std::hypot(distance + along, offset * std::sin(angle));
      const double plane = distance + along;
      flat = std::max(flat, std::abs(exact - plane));
      // FastSolver's own: the wave front bends.
      bent = std::max(bent, std::abs(exact - plane - (offset * offset - along * along) / (2 * distance)));
    }
    EXPECT_NEAR(flat * wave_number, c["worst_phase_err_rad"].get<double>(), 1e-5);
    EXPECT_LE(flat * wave_number, c["bound_rad"].get<double>());
    EXPECT_LT(bent, 0.1 * flat);
  }
}

TEST(FastSolver, IsSmoothNearlyReciprocalAndReceivesLessThanWasSent) {
  const Scene scene = mixed_scene();
  const auto h = solve_fast(scene);
  std::vector<Complex> wide(h.begin(), h.end());
  const double level = rms(wide);
  const std::size_t row = h.size() / static_cast<std::size_t>(scene.snapshots);
  double kink = 0;
  for (std::size_t i = row; i + row < h.size(); ++i) {
    ASSERT_LT(std::abs(h[i]), 1);
    kink = std::max(kink, std::abs(wide[i - row] - 2.0 * wide[i] + wide[i + row]));
  }
  EXPECT_LT(kink, 1e-3 * level) << "at sixteen times finer steps than data sets have";
  Scene back = scene;
  std::swap(back.transmitter, back.receivers[0][1]);
  back.receivers[0] = {back.receivers[0][1]};  // one antenna: the middle of its array
  back.receivers.resize(1);
  Scene there = scene;
  there.receivers[0] = {there.receivers[0][1]};
  there.receivers.resize(1);
  const auto a = solve_fast(there), b = solve_fast(back);
  double apart = 0;
  for (std::size_t i = 0; i < a.size(); ++i) apart = std::max(apart, double{std::abs(a[i] - b[i])});
  EXPECT_LT(apart, 2e-2 * level);
}

TEST(FastSolver, TakesAnyNumberOfSubcarriersAndAntennas) {
  Scene scene = mixed_scene();
  scene.snapshots = 3;
  scene.tones.clear();
  for (int k = -35; k <= 35; ++k) scene.tones.push_back(k);
  for (auto& receiver : scene.receivers) receiver.resize(1);
  const auto truth = solve_reference(scene);
  EXPECT_LT(rms(difference(solve_fast(scene), truth)) / rms(truth), 1e-2);
}

TEST(FastSolver, SolvingAgainGivesTheSameBits) {
  const Scene scene = mixed_scene();
  const auto bodies = bodies_over_time(scene);
  FastSolver solver(scene);
  std::vector<std::complex<float>> first(bodies.size() * 30 * 6), again(first.size());
  solver.solve(bodies, first);
  solver.solve(bodies, again);
  EXPECT_EQ(first, again);
  EXPECT_EQ(first, solve_fast(scene));
}

// What is left out of shadows because it is faint is not seen: a walker in the furnished office, by both solvers.
TEST(FastSolver, AFurnishedRoomWithSomebodyInItAgrees) {
  Scene scene = read_room_plan("office").still;
  scene.receivers.resize(1);
  scene.snapshots = 3;
  Body trunk;
  trunk.shape = Shape::ellipsoid;
  trunk.half_m = {0.16, 0.22, 0.35};
  trunk.centre = {2.5, 2.2, 1.1};
  scene.bodies = {{trunk, {0.5, 0.8, 0}}};
  const auto truth = solve_reference(scene);
  EXPECT_LT(rms(difference(solve_fast(scene), truth)) / rms(truth), 1e-2);
}

}  // namespace
}  // namespace csipose::sim
