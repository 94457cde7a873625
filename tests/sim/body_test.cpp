#include "sim/body.h"

#include <gtest/gtest.h>

#include <cmath>
#include <random>

#include "sim/geometry.h"
#include "sim/reference_solver.h"
#include "sim/shadow.h"
#include "tests/sim/golden_scene.h"

namespace csipose::sim {
namespace {
using Complex = std::complex<double>;
const double kWavelength_m = Band{}.wavelength_m();

void expect_channel(const Scene& scene, const Antenna& rx, const nlohmann::json& expected, double relative) {
  const auto golden = testing::complex_list(expected);
  const auto paths = reference_paths(scene, rx, 0);
  double rms = 0, error = 0;
  for (std::size_t k = 0; k < kSubcarriers; ++k) {
    rms += std::norm(golden[k]) / kSubcarriers;
    error = std::max(error, std::abs(transfer(paths, Band{}.frequency_hz(k)) - golden[k]));
  }
  EXPECT_LT(error, relative * std::sqrt(rms));
}

Scene free_space_with(const Body& body, const Vec3& tx) {
  Scene scene;
  scene.walls = false;
  scene.transmitter.position = tx;
  scene.bodies = {{body, {}}};
  return scene;
}

TEST(Sphere, MeetsTheGoldenCases) {
  CSIPOSE_NEEDS_SHARED_DATA();
  int lit = 0;
  for (const auto& c : testing::golden_list("sphere.json", "cases")) {
    const Body body = sphere(vec3(c["c"]), c["radius"].get<double>(), "skin_dry");
    const Vec3 tx = vec3(c["tx"]), rx = vec3(c["rx"]);
    const Leg leg{tx, rx, 0, glm::distance(tx, rx)};
    EXPECT_LT(std::abs(contour_shadow(body, leg, kWavelength_m) - testing::complex_number(c["F_contour"])),
              1e-5);
    EXPECT_LT(std::abs(shadow_factor(body, leg, kWavelength_m) - testing::complex_number(c["F_leg"])), 1e-5);
    const auto found = reflections(body, tx, rx, kWavelength_m);
    ASSERT_EQ(found.size(), c.contains("P") ? 1u : 0u);
    if (c.contains("P")) {
      ++lit;
      EXPECT_LT(glm::distance(found[0].point, vec3(c["P"])), 1e-7);
      EXPECT_NEAR(found[0].s1_m + found[0].s2_m, c["L"].get<double>(), 1e-9);
      EXPECT_NEAR(found[0].cos_incidence, c["cos_i"].get<double>(), 1e-7);
      EXPECT_NEAR(std::abs(found[0].spreading), c["A"].get<double>(), 1e-8);
    }
    expect_channel(free_space_with(body, tx), {rx}, c["H_skin_hw_dipole"], 1e-5);
  }
  EXPECT_GT(lit, 3);
}

// Physical truth, for two scalar boundary conditions: how far the model is from it, not how well we compute
// the model.
TEST(Sphere, ModelIsNearTheExactSeries) {
  CSIPOSE_NEEDS_SHARED_DATA();
  for (const auto& c : testing::golden_list("sphere.json", "cases")) {
    const Body body = sphere(vec3(c["c"]), c["radius"].get<double>(), "metal");
    const Vec3 tx = vec3(c["tx"]), rx = vec3(c["rx"]);
    const double direct_m = glm::distance(tx, rx);
    const Complex shadow = shadow_factor(body, {tx, rx, 0, direct_m}, kWavelength_m);
    Complex echo = 0;
    for (const Reflection& r : reflections(body, tx, rx, kWavelength_m))
      echo +=
          r.spreading * direct_m * std::polar(1.0, -2 * kPi / kWavelength_m * (r.s1_m + r.s2_m - direct_m));
    const double tolerance = std::abs(shadow) < 0.9 ? 0.35 : 0.1;
    EXPECT_LT(std::abs(shadow - echo - testing::complex_number(c["exact_total_over_los_soft"])), tolerance);
    EXPECT_LT(std::abs(shadow + echo - testing::complex_number(c["exact_total_over_los_hard"])), tolerance);
  }
}

void expect_reflections(const std::vector<Reflection>& found, const nlohmann::json& golden) {
  std::size_t matched = 0;
  for (const auto& g : golden) {
    const int face = g["face"].is_null() ? kWholeSurface : g["face"].get<int>();
    const auto r =
        std::find_if(found.begin(), found.end(), [&](const Reflection& f) { return f.face == face; });
    const Complex spreading = testing::complex_number(g["A"]);
    if (r == found.end()) {
      EXPECT_LT(std::abs(spreading), 1e-5 * 10) << "face " << face << " is missing";  // cut off by |A| s1
      continue;
    }
    ++matched;
    EXPECT_LT(glm::distance(r->point, vec3(g["P"])), 1e-6);
    EXPECT_NEAR(r->s1_m + r->s2_m, g["L"].get<double>(), 1e-9);
    EXPECT_NEAR(r->cos_incidence, g["cos_i"].get<double>(), 1e-7);
    EXPECT_LT(std::abs(r->spreading - spreading), 1e-5);
    if (!g["window"].is_null()) {
      EXPECT_LT(std::abs(r->window - testing::complex_number(g["window"])), 1e-5);
    }
  }
  EXPECT_EQ(matched, found.size());
}

TEST(Bodies, MeetTheGoldenCases) {
  CSIPOSE_NEEDS_SHARED_DATA();
  for (const auto& c : testing::golden_list("bodies.json", "cases")) {
    SCOPED_TRACE(c["kind"].get<std::string>());
    const Body body = body_of(c);
    const Vec3 tx = vec3(c["tx"]), rx = vec3(c["rx"]);
    expect_reflections(reflections(body, tx, rx, kWavelength_m), c["reflections"]);
    const Vec3 a = vec3(c["shadow"]["a"]), b = vec3(c["shadow"]["b"]);
    const Leg leg{a, b, 0, glm::distance(a, b)};
    EXPECT_LT(std::abs(contour_shadow(body, leg, kWavelength_m) -
                       testing::complex_number(c["shadow"]["F_contour"])),
              1e-5);
    EXPECT_LT(
        std::abs(shadow_factor(body, leg, kWavelength_m) - testing::complex_number(c["shadow"]["F_leg"])),
        1e-5);
    expect_channel(free_space_with(body, tx), {rx}, c["H_hw_dipole"], 1e-5);
  }
}

// Far away a sphere of any bistatic angle has the cross section pi a^2 of geometric optics.
TEST(Sphere, HasItsRadarCrossSection) {
  for (const double radius : {0.1, 0.2, 0.3, 0.5})
    for (const double bistatic_deg : {0.0, 30.0, 60.0, 90.0, 120.0, 150.0}) {
      const double angle = bistatic_deg * kPi / 180;
      const Vec3 s{1000, 0, 0}, q{1000 * std::cos(angle), 1000 * std::sin(angle), 0};
      const auto found = reflections(sphere({0, 0, 0}, radius, "metal"), s, q, kWavelength_m);
      ASSERT_EQ(found.size(), 1u);
      const double scattered = std::abs(found[0].spreading) * found[0].s1_m * found[0].s2_m;
      EXPECT_NEAR(4 * kPi * scattered * scattered / (kPi * radius * radius), 1, 3e-3);
    }
}

TEST(Sphere, MeetsTheGoldenCrossSections) {
  CSIPOSE_NEEDS_SHARED_DATA();
  for (const auto& c : testing::golden_list("rcs.json", "cases"))
    for (const auto& g : c["go_bistatic"]) {
      const double angle = g["bistatic_deg"].get<double>() * kPi / 180;
      const auto found = reflections(sphere({0, 0, 0}, c["radius"].get<double>(), "metal"), {1000, 0, 0},
                                     {1000 * std::cos(angle), 1000 * std::sin(angle), 0}, kWavelength_m);
      ASSERT_EQ(found.size(), 1u);
      const double scattered = std::abs(found[0].spreading) * found[0].s1_m * found[0].s2_m;
      EXPECT_NEAR(4 * kPi * scattered * scattered / g["sigma"].get<double>(), 1, 3e-3);
    }
}

double fitted_slope(const std::vector<double>& y, double step) {
  const double middle = (static_cast<double>(y.size()) - 1) / 2;
  double xy = 0, xx = 0;
  for (std::size_t i = 0; i < y.size(); ++i) {
    const double x = static_cast<double>(i) - middle;
    xy += x * y[i];
    xx += x * x;
  }
  return xy / xx / step;
}

TEST(Doppler, MeetsTheGoldenRates) {
  CSIPOSE_NEEDS_SHARED_DATA();
  for (const auto& c : testing::golden_list("doppler.json", "cases")) {
    const Vec3 velocity = c["v"].is_array() ? vec3(c["v"]) : Vec3{-c["v"].get<double>(), 0, 0};
    std::vector<double> turns;
    for (int m = 0; m < 20; ++m) {
      const Vec3 centre = vec3(c["c0"]) + m * 0.0025 * velocity;
      const auto found = reflections(sphere(centre, c["radius"].get<double>(), "skin_dry"), vec3(c["tx"]),
                                     vec3(c["rx"]), kWavelength_m);
      ASSERT_EQ(found.size(), 1u);
      const double length_m = found[0].s1_m + found[0].s2_m;
      if (c.contains("L")) {
        EXPECT_NEAR(length_m, c["L"][m].get<double>(), 1e-7);
      }
      if (c.contains("A")) {
        EXPECT_NEAR(std::abs(found[0].spreading), c["A"][m].get<double>(), 1e-8);
      }
      turns.push_back(-length_m / kWavelength_m);
    }
    const double rate_hz = fitted_slope(turns, 0.0025);
    EXPECT_NEAR(rate_hz, c["phase_rate_hz"].get<double>(), 1e-3);
    if (c.contains("two_v_over_lambda")) {
      EXPECT_NEAR(rate_hz / c["two_v_over_lambda"].get<double>(), 1, 2e-4);
    }
  }
}

// A(u) against ray tubes: the rule 1/rho1 of a convex mirror, which our closed form must equal on a sphere.
TEST(Sphere, SpreadingIsThatOfAConvexMirror) {
  std::mt19937 random(3);
  std::uniform_real_distribution<double> place(-3, 3), size(0.05, 0.5);
  int lit = 0;
  for (int trial = 0; trial < 300; ++trial) {
    const Vec3 s{place(random), place(random), place(random)}, q{place(random), place(random), place(random)};
    const double a = size(random);
    if (glm::length(s) < 1 || glm::length(q) < 1) continue;
    for (const Reflection& r : reflections(sphere({0, 0, 0}, a, "metal"), s, q, kWavelength_m)) {
      ++lit;
      const double rho1 = 1 / (1 / r.s1_m + 2 / (a * r.cos_incidence)),
                   rho2 = 1 / (1 / r.s1_m + 2 * r.cos_incidence / a);
      const double expected = std::sqrt(rho1 * rho2 / ((rho1 + r.s2_m) * (rho2 + r.s2_m))) / r.s1_m;
      EXPECT_NEAR(std::abs(r.spreading) / expected, 1, 1e-8);
      // and the law of reflection
      const Vec3 in = glm::normalize(r.point - s), out = glm::normalize(q - r.point);
      EXPECT_LT(glm::distance(mirrored(in, r.normal), out), 1e-7);
    }
  }
  EXPECT_GT(lit, 100);
}

TEST(BigFace, ReflectsLikeAMirrorDeepInsideByHalfOnItsEdgeNotAtAllFarOff) {
  const Body plate{Shape::box, {0, 0, 0}, Mat3{1}, {4, 4, 0.01}, surface_of("metal")};
  const auto window_at = [&](double x) {
    for (const Reflection& r : reflections(plate, {x, 0, 1}, {x, 0, 1.001}, kWavelength_m))
      if (r.face == 4) return std::abs(r.window);
    return 0.0;
  };
  EXPECT_NEAR(window_at(0), 1, 0.06);
  EXPECT_NEAR(window_at(4), 0.5, 0.03);
  EXPECT_NEAR(window_at(6), 0, 0.06);
}

// Tables of the Fresnel integrals: C and S at 1 and 2 (A&S table 7.7).
TEST(EdgeTransition, IsTheFresnelIntegral) {
  const auto by_table = [](double c, double s) { return 0.5 + Complex(0.5, 0.5) * Complex(c, -s); };
  EXPECT_LT(std::abs(edge_transition(1) - by_table(0.7798934003768228, 0.4382591473903548)), 1e-12);
  EXPECT_LT(std::abs(edge_transition(2) - by_table(0.4882534060753408, 0.3434156783636982)), 1e-12);
  EXPECT_EQ(edge_transition(0), Complex(0.5));
  EXPECT_LT(std::abs(edge_transition(-3) + edge_transition(3) - 1.0), 1e-12);
  EXPECT_LT(std::abs(edge_transition(5.999999) - edge_transition(6.000001)), 1e-5) << "two formulas meet";
  EXPECT_LT(std::abs(edge_transition(50) - 1.0), 0.01);
}

// Babinet: a screen without bound dims to nothing behind its middle.
TEST(Shadow, LeavesAboutHalfOnTheEdgeAndLittleBehindABigBody) {
  const Body wall{Shape::box, {2, 0, 0}, Mat3{1}, {0.01, 3, 3}, surface_of("metal")};
  const auto through = [&](double y) {
    return std::abs(shadow_factor(wall, {{-8, y, 0}, {12, y, 0}, 0, 20}, kWavelength_m));
  };
  EXPECT_LT(through(0), 0.15);
  EXPECT_NEAR(through(3), 0.5, 0.05);
  EXPECT_EQ(through(5), 1);
}

TEST(Shadow, BodiesBehindAnEndDimNothing) {
  const Body ball = sphere({-1, 0, 0}, 0.3, "skin_dry");
  EXPECT_EQ(shadow_factor(ball, {{0, 0, 0}, {4, 0, 0}, 0, 4}, kWavelength_m), Complex(1));
}

}  // namespace
}  // namespace csipose::sim
