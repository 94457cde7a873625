#include "sim/walk.h"

#include <gtest/gtest.h>

#include "tests/sim/golden_scene.h"

namespace csipose::sim {
namespace {

TEST(Walking, MeetsTheGoldenSteps) {
  CSIPOSE_NEEDS_SHARED_DATA();
  for (const auto& c : testing::golden_list("human_walk.json", "cases")) {
    const Figure figure(c["stature"].get<double>());
    const Gait gait(figure, c["v"].get<double>());
    EXPECT_NEAR(gait.cycle_s, c["Tc"].get<double>(), 1e-9);
    EXPECT_NEAR(gait.stride_m, c["stride"].get<double>(), 1e-9);
    EXPECT_NEAR(gait.stance_fraction, c["stance_fraction"].get<double>(), 1e-9);
    for (std::size_t i = 0; i < c["t"].size(); ++i) {
      const Stance stance = stance_of(figure, walking(gait, Course{}, c["t"][i].get<double>()));
      EXPECT_LT(glm::distance(stance.pelvis, vec3(c["pelvis"][i])), 1e-6);
      EXPECT_LT(glm::distance(stance.knees[kRight], vec3(c["r_knee"][i])), 1e-6);
      EXPECT_LT(glm::distance(stance.ankles[kRight], vec3(c["r_ankle"][i])), 1e-6);
      EXPECT_LT(glm::distance(stance.knees[kLeft], vec3(c["l_knee"][i])), 1e-6);
      EXPECT_LT(glm::distance(stance.ankles[kLeft], vec3(c["l_ankle"][i])), 1e-6);
    }
  }
}

struct Walk {
  Figure figure{1.7};
  Gait gait{figure, 0.8};
  Course course{{3.0, 1.75, 0}, 1.57, 1 / 1.0};
  Stance at(double t_s) const { return stance_of(figure, walking(gait, course, t_s)); }
};

// Round a circle too: no bone stretches, a flat foot does not move, nobody sinks into the floor.
TEST(Walking, KeepsBonesAndGroundOnACircle) {
  const Walk walk;
  for (double t = 0; t < 8; t += 0.01) {
    const Stance s = walk.at(t), next = walk.at(t + 1e-4);
    for (const std::size_t side : {kLeft, kRight}) {
      ASSERT_NEAR(glm::distance(s.hips[side], s.knees[side]), walk.figure.thigh_m(), 1e-9);
      ASSERT_NEAR(glm::distance(s.knees[side], s.ankles[side]), walk.figure.shank_m(), 5e-3);
      ASSERT_NEAR(glm::distance(s.shoulders[side], s.elbows[side]), 0.186 * 1.7, 1e-9);
      ASSERT_NEAR(glm::distance(s.elbows[side], s.wrists[side]), 0.146 * 1.7, 1e-9);
      ASSERT_GE(s.ankles[side].z, walk.figure.ankle_height_m() - 1e-9);
      const bool flat =
          s.ankles[side].z < walk.figure.ankle_height_m() + 1e-9 && next.ankles[side].z == s.ankles[side].z;
      if (flat) {
        ASSERT_LT(glm::distance(s.ankles[side], next.ankles[side]), 1e-12) << t;
      }
    }
    ASSERT_LT(glm::distance(s.pelvis, next.pelvis), 1e-4 * 1.5) << "no jump";
  }
}

TEST(Walking, GoesRoundItsCircle) {
  const Walk walk;
  const Vec3 middle = walk.course.start + Vec3{-std::sin(1.57), std::cos(1.57), 0};
  for (double t = 0; t < 8; t += 0.1) {
    Vec3 p = walk.at(t).pelvis - middle;
    p.z = 0;
    EXPECT_NEAR(glm::length(p), 1.0, 1e-9);
  }
}

TEST(Human, LeftIsLeft) {
  const Figure figure(1.7);
  const Stance s =
      stance_of(figure, walking(Gait(figure, 0.8), Course{}, 0.2));  // looks along +x: left is +y
  const auto joints = joints_of(figure, s);
  EXPECT_GT(joints[2].y, joints[3].y);
  EXPECT_GT(joints[12].y, joints[13].y);
  EXPECT_GT(s.hands[kLeft].y, s.hands[kRight].y);
  EXPECT_GT(joints[1].z, joints[0].z);
}

TEST(Human, ArmsGoWhereTheirAnglesSay) {
  const Figure figure(2.0);
  Posture posture = walking(Gait(figure, 0.8), Course{}, 0.2);
  posture.trunk_yaw_rad = 0;
  posture.arms[kLeft] = {1.5707963267948966, 0, 0};
  posture.arms[kRight] = {3.1415926535897931, 0, 0};
  const Stance s = stance_of(figure, posture);
  EXPECT_LT(glm::distance(s.elbows[kLeft] - s.shoulders[kLeft], Vec3{0.186 * 2, 0, 0}), 1e-9);
  EXPECT_LT(glm::distance(s.hands[kRight] - s.shoulders[kRight], Vec3{0, 0, 0.386 * 2}), 1e-9);
}

TEST(Human, HasSixteenBodiesOverItsJoints) {
  const Walk walk;
  const Stance s = walk.at(0.4);
  const auto bodies = bodies_of(walk.figure, s, surface_of("skin_dry"));
  ASSERT_EQ(bodies.size(), 16u);
  for (const Body& body : bodies) {
    EXPECT_NEAR(glm::determinant(body.axes), 1, 1e-9);
    EXPECT_GT(body.centre.z - body.support_m({0, 0, 1}), -0.01);
  }
  // Each joint lies in or near the skin of some ellipsoid.
  for (const Vec3& joint : joints_of(walk.figure, s)) {
    double nearest = 1e9;
    for (const Body& body : bodies) {
      const Vec3 local = glm::transpose(body.axes) * (joint - body.centre) / body.half_m;
      nearest = std::min(nearest, glm::length(local));
    }
    EXPECT_LT(nearest, 1.6);
  }
}

}  // namespace
}  // namespace csipose::sim
