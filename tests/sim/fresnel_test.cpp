#include "sim/fresnel.h"

#include <gtest/gtest.h>

#include <cmath>
#include <numbers>

#include "sim/material.h"
#include "tests/sim/golden.h"

namespace csipose::sim {
namespace {
constexpr double kCarrier_hz = 5.64e9, kLambda_m = 299792458.0 / kCarrier_hz;

void expect_near(const Fresnel& got, const nlohmann::json& expected, const char* te, const char* tm) {
  EXPECT_LT(std::abs(got.te - testing::complex_number(expected[te])), 1e-9) << expected;
  EXPECT_LT(std::abs(got.tm - testing::complex_number(expected[tm])), 1e-9) << expected;
}

TEST(Fresnel, MeetsTheGoldenCoefficients) {
  CSIPOSE_NEEDS_SHARED_DATA();
  const auto golden = testing::golden("fresnel.json");
  ASSERT_GT(golden["cases"].size(), 40u);
  for (const auto& c : golden["cases"]) {
    const Material* material = find_material(c["material"].get<std::string>());
    ASSERT_NE(material, nullptr) << c["material"];
    const auto eta = material->permittivity(kCarrier_hz);
    EXPECT_LT(std::abs(eta - testing::complex_number(c["eta"])), 1e-9 * std::abs(eta)) << material->name;
    const double cosine = std::cos(c["angle_deg"].get<double>() * std::numbers::pi / 180);
    expect_near(half_space(eta, cosine), c["halfspace"], "R_te", "R_tm");
    for (const char* slab : {"slab", "slab_0p1"}) {
      if (!c.contains(slab) || c[slab].is_null()) continue;
      const double thickness_m = c[slab]["thickness"].get<double>();
      expect_near(slab_reflection(eta, thickness_m, kLambda_m, cosine), c[slab], "R_te", "R_tm");
      expect_near(slab_transmission(eta, thickness_m, kLambda_m, cosine), c[slab], "T_te", "T_tm");
    }
  }
}

// Published values of dry skin and muscle at 5.8 GHz (IFAC database of dielectric properties).
TEST(Material, TissueHasItsPublishedValues) {
  const double f = 5.8e9, per_S_m = 2 * std::numbers::pi * f * kVacuumPermittivity_F_m;
  const auto skin = find_material("skin_dry")->permittivity(f),
             muscle = find_material("muscle")->permittivity(f);
  EXPECT_NEAR(skin.real(), 35.114, 5e-4);
  EXPECT_NEAR(-skin.imag() * per_S_m, 3.717, 5e-4);
  EXPECT_NEAR(muscle.real(), 48.485, 5e-4);
  EXPECT_NEAR(-muscle.imag() * per_S_m, 4.962, 5e-4);
}

TEST(Material, UnknownNameIsNotThere) { EXPECT_EQ(find_material("unobtainium"), nullptr); }

// What is not reflected or let through by a lossless slab would be energy from nowhere.
TEST(Fresnel, LosslessSlabKeepsEnergy) {
  for (double angle = 0; angle < 1.5; angle += 0.1)
    for (double thickness_m = 0.001; thickness_m < 0.2; thickness_m *= 1.7) {
      const Fresnel r = slab_reflection(4.0, thickness_m, kLambda_m, std::cos(angle));
      const Fresnel t = slab_transmission(4.0, thickness_m, kLambda_m, std::cos(angle));
      EXPECT_NEAR(std::norm(r.te) + std::norm(t.te), 1, 1e-12);
      EXPECT_NEAR(std::norm(r.tm) + std::norm(t.tm), 1, 1e-12);
    }
}

TEST(Fresnel, NoTmReflectionAtBrewstersAngle) {
  const double cosine = std::cos(std::atan(2.0));  // tan = sqrt(eps)
  EXPECT_LT(std::abs(half_space(4.0, cosine).tm), 1e-12);
}

// A perfect mirror turns the field so that its part along the surface cancels the incident one.
TEST(Reflected, MetalLeavesNoFieldAlongTheSurface) {
  const Vec3 n{0, 0, 1}, k = glm::normalize(Vec3{0.3, -0.5, -0.8});
  const Vec3 e = glm::normalize(glm::cross(k, Vec3{1, 2, 3}));
  const Field out = reflected({e, {}}, k, n, {-1, 1});
  EXPECT_NEAR(out.re.x + e.x, 0, 1e-12);
  EXPECT_NEAR(out.re.y + e.y, 0, 1e-12);
  EXPECT_NEAR(glm::dot(out.re, mirrored(k, n)), 0, 1e-12);
  EXPECT_NEAR(glm::length(out.re), 1, 1e-12);
}

TEST(Reflected, HeadOnHasNoPreferredPolarisation) {
  const Field out = reflected({{1, 0, 0}, {}}, {0, 0, -1}, {0, 0, 1}, half_space(4.0, 1));
  EXPECT_NEAR(out.re.x, -1.0 / 3, 1e-12);  // (1 - n) / (1 + n), n = 2
  EXPECT_NEAR(out.re.y, 0, 1e-12);
}

}  // namespace
}  // namespace csipose::sim
