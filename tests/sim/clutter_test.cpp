#include "sim/clutter.h"

#include <gtest/gtest.h>

#include <cmath>

#include "sim/fast_solver.h"
#include "sim/geometry.h"
#include "sim/random_room.h"
#include "sim/reference_solver.h"

namespace csipose::sim {
namespace {

/// Midpoints over the half-space z > 0.
template <class Function>
double over_half_space(const Function& of) {
  constexpr int kSteps = 400;
  double sum = 0;
  for (int i = 0; i < kSteps; ++i)
    for (int j = 0; j < kSteps; ++j) {
      const double z = (i + 0.5) / kSteps, turn = 2 * kPi * (j + 0.5) / kSteps, across = std::sqrt(1 - z * z);
      sum += of(Vec3{across * std::cos(turn), across * std::sin(turn), z});
    }
  return sum * 2 * kPi / (kSteps * kSteps);
}

Vec3 coming_in(double angle) { return {std::sin(angle), 0, -std::cos(angle)}; }

TEST(ScatterPattern, SendsAllItHasIntoTheHalfSpace) {
  const Vec3 normal{0, 0, 1};
  for (const double angle : {0.0, 0.5, 1.2, 1.5})
    for (const auto pattern :
         {ScatterPattern::lambertian, ScatterPattern::directive, ScatterPattern::backscatter})
      for (const int exponent : {1, 4, 7}) {
        const Clutter clutter{0.3, pattern, exponent, 3, 0.7, 1, 0};
        const Vec3 in = coming_in(angle);
        EXPECT_NEAR(
            over_half_space([&](const Vec3& out) { return scatter_pattern(clutter, normal, in, out); }), 1,
            2e-3)
            << angle << " " << exponent;
      }
}

TEST(ScatterPattern, ADirectiveOneIsStrongestAlongTheMirroredRay) {
  const Clutter clutter{0.3, ScatterPattern::directive, 4, 4, 0.5, 1, 0};
  const Vec3 in = coming_in(0.7), mirror{in.x, 0, -in.z};
  const double there = scatter_pattern(clutter, {0, 0, 1}, in, mirror);
  EXPECT_GT(there, scatter_pattern(clutter, {0, 0, 1}, in, {0, 0, 1}));
  EXPECT_GT(there, scatter_pattern(clutter, {0, 0, 1}, in, Vec3{-in.x, 0, -in.z}));
  EXPECT_EQ(scatter_pattern(clutter, {0, 0, 1}, in, in), 0) << "nothing goes into the wall";
}

TEST(LobeIntegral, OfExponentOneIsPiTimesOnePlusHalfTheCosine) {
  for (const double cosine : {0.1, 0.6, 1.0})
    EXPECT_NEAR(lobe_integral(1, cosine), kPi * (1 + cosine / 2), 1e-12);
}

Scene room_with(double scattering) {
  Scene scene = random_room({5, 4, 3}, draw_walls(3, 0), draw_devices(3, 0, {5, 4, 3}));
  Clutter clutter;
  clutter.scattering = scattering;
  if (scattering > 0) scene.set_clutter(clutter);
  return scene;
}

double diffuse_power(const Scene& scene, double scattering) {
  Clutter clutter;
  clutter.scattering = scattering;
  double power = 0;
  for (const ClutterPath& path :
       clutter_paths(scene.room, clutter, scene.transmitter, scene.receivers[0][1], scene.wavelength_m()))
    power += std::norm(path.amplitude);
  return power;
}

TEST(Clutter, PowerGrowsWithTheSquareAndStaysBelowWhatWallsReflect) {
  const Scene scene = room_with(0);
  EXPECT_NEAR(diffuse_power(scene, 0.2) / diffuse_power(scene, 0.1), 4, 1e-9);
  double specular = 0;
  for (const Path& path : reference_paths(scene, scene.receivers[0][1], 0))
    if (!path.walls.empty()) specular += std::norm(path.amplitude);
  EXPECT_LT(diffuse_power(scene, 0.35), specular);
  EXPECT_GT(diffuse_power(scene, 0.35), 1e-4 * specular);
  EXPECT_EQ(
      clutter_paths(scene.room, {}, scene.transmitter, scene.receivers[0][1], scene.wavelength_m()).size(),
      0u);
}

TEST(Clutter, BothSolversHaveItAndTakeItFromTheMirrorsShare) {
  const Scene smooth = room_with(0), rough = room_with(0.3);
  const auto truth = solve_reference(rough);
  const auto fast = solve_fast(rough);
  double error = 0, all = 0;
  for (std::size_t i = 0; i < truth.size(); ++i)
    error += std::norm(truth[i] - std::complex<double>(fast[i])), all += std::norm(truth[i]);
  EXPECT_LT(std::sqrt(error / all), 1e-5);
  const auto before = reference_paths(smooth, smooth.receivers[1][0], 0),
             after = reference_paths(rough, rough.receivers[1][0], 0);
  for (std::size_t i = 0; i < before.size(); ++i)
    EXPECT_NEAR(
        std::abs(after[i].amplitude),
        std::abs(before[i].amplitude) * std::pow(1 - 0.09, static_cast<double>(before[i].walls.size()) / 2),
        1e-12);
}

TEST(Clutter, PhasesAreDrawnForEachClip) {
  const Scene scene = room_with(0);
  const auto first = [&](std::uint32_t clip) {
    Clutter clutter = draw_clutter(5, clip);
    clutter.scattering = 0.2;
    return clutter_paths(scene.room, clutter, scene.transmitter, scene.receivers[0][0],
                         scene.wavelength_m())[7]
        .amplitude;
  };
  EXPECT_EQ(first(1), first(1));
  EXPECT_NE(first(1), first(2));
  for (std::uint32_t clip = 0; clip < 50; ++clip) {
    EXPECT_GE(draw_clutter(5, clip).scattering, 0);
    EXPECT_LT(draw_clutter(5, clip).scattering, 0.35);
  }
}

}  // namespace
}  // namespace csipose::sim
