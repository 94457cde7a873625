// What must hold of every body in every action: bones keep their lengths, joints their limits, feet the floor.
//
// The clips are few by default; CSIPOSE_CLIPS=10000 build/release/tests/sim_people_test checks as many as it says.
#include "sim/people.h"

#include <gtest/gtest.h>

#include <cstdlib>
#include <numbers>

#include "proto/pose.h"

namespace csipose::sim {
namespace {
constexpr double kSeconds = 6.0;

std::uint32_t clips() {
  const char* asked = std::getenv("CSIPOSE_CLIPS");
  return asked ? static_cast<std::uint32_t>(std::strtoul(asked, nullptr, 10)) : 400;
}

Stage stage_of(std::span<const Action> allowed) {
  Stage stage;
  stage.allowed.assign(allowed.begin(), allowed.end());
  return stage;
}

Crowd crowd_of(const Stage& stage, std::size_t count, std::uint64_t seed, std::uint32_t clip) {
  Crowd crowd(stage, count, seed, clip);
  crowd.plan_until(kSeconds);
  return crowd;
}

constexpr std::array<Action, kActions> kAll{Action::walk,  Action::raise_arms, Action::wave, Action::stretch,
                                            Action::bend,  Action::squat,      Action::sit,  Action::turn,
                                            Action::stand, Action::fall};

double angle_between(const Vec3& a, const Vec3& b) {
  return std::acos(std::clamp(glm::dot(glm::normalize(a), glm::normalize(b)), -1.0, 1.0));
}

void expect_bones(const Figure& figure, const Stance& s) {
  const double h = figure.stature_m;
  for (const std::size_t side : {kLeft, kRight}) {
    ASSERT_NEAR(glm::distance(s.hips[side], s.knees[side]), figure.thigh_m(side), 1e-9);
    ASSERT_NEAR(glm::distance(s.knees[side], s.ankles[side]), figure.shank_m(side), 1e-9);
    ASSERT_NEAR(glm::distance(s.shoulders[side], s.elbows[side]), figure.upper_arm_m(side), 1e-9);
    ASSERT_NEAR(glm::distance(s.elbows[side], s.wrists[side]), figure.forearm_m(side), 1e-9);
    ASSERT_NEAR(glm::distance(s.wrists[side], s.hands[side]), 0.054 * h, 1e-9);
  }
  ASSERT_NEAR(glm::distance(s.hips[kLeft], s.hips[kRight]), 2 * figure.half_hips_m(), 1e-9);
  ASSERT_NEAR(glm::distance(s.shoulders[kLeft], s.shoulders[kRight]), 2 * figure.half_shoulders_m(), 1e-9);
  ASSERT_NEAR(glm::distance(s.pelvis, s.neck), 0.315 * h, 1e-9);
}

void expect_limits(const Stance& s) {
  for (const std::size_t side : {kLeft, kRight}) {
    ASSERT_LE(angle_between(s.knees[side] - s.hips[side], s.ankles[side] - s.knees[side]), kKneeLimit_rad);
    ASSERT_LE(angle_between(s.elbows[side] - s.shoulders[side], s.wrists[side] - s.elbows[side]),
              kElbowLimit_rad);
    // The knee bends forward: seen from the side it lies before the line from hip to ankle, or on it.
    const Vec3 leg = s.ankles[side] - s.hips[side], thigh = s.knees[side] - s.hips[side];
    const Vec3 off = thigh - glm::dot(thigh, leg) / glm::dot(leg, leg) * leg;
    const Vec3 front = s.pelvis_forward + glm::cross(glm::normalize(leg), s.pelvis_left);
    ASSERT_GE(glm::dot(off, front), -1e-9);
  }
}

void expect_floor(const Figure& figure, const Stance& s) {
  double lowest = 1e9;
  for (const Body& body : bodies_of(figure, s, {}))
    lowest = std::min(lowest, body.centre.z - body.support_m({0, 0, 1}));
  ASSERT_GT(lowest, -0.02) << "nothing sinks into the floor";
  ASSERT_LT(lowest, 0.03) << "nobody hovers";
  for (const Vec3& joint : joints_of(figure, s)) ASSERT_GT(joint.z, 0.02);
}

void expect_sides(const Stance& s) {
  ASSERT_GT(glm::dot(s.hips[kLeft] - s.hips[kRight], s.pelvis_left), 0);
  ASSERT_GT(glm::dot(s.shoulders[kLeft] - s.shoulders[kRight], s.left), 0);
  ASSERT_NEAR(glm::dot(glm::cross(s.forward, s.left), s.up), 1, 1e-9) << "right-handed";
}

/// No joint is faster than a hand in a brisk wave or a head that falls, and none jumps.
void expect_smooth(const std::array<Vec3, kJoints>& before, const std::array<Vec3, kJoints>& now,
                   const std::array<Vec3, kJoints>& after, double dt_s) {
  for (std::size_t j = 0; j < kJoints; ++j) {
    ASSERT_LT(glm::distance(before[j], now[j]) / dt_s, 8.0) << j;
    ASSERT_LT(glm::length(after[j] - 2.0 * now[j] + before[j]) / (dt_s * dt_s), 250.0) << j;
  }
}

/// A foot on the floor does not move. It is there while it is low, and low again a moment later.
void expect_no_skating(const Figure& figure, const Stance& now, const Stance& next) {
  for (const std::size_t side : {kLeft, kRight}) {
    const double rest = figure.ankle_height_m();
    if (now.ankles[side].z < rest + 1e-12 && next.ankles[side].z < rest + 1e-12) {
      ASSERT_LT(glm::distance(now.ankles[side], next.ankles[side]), 1e-9);
    }
  }
}

void expect_body_holds(const Motion& person, double t_s) {
  constexpr double kMoment_s = 1e-3;
  const Figure& figure = person.figure();
  const Stance s = person.at(t_s), before = person.at(t_s - kMoment_s), after = person.at(t_s + kMoment_s);
  expect_bones(figure, s);
  expect_limits(s);
  expect_floor(figure, s);
  expect_sides(s);
  expect_smooth(joints_of(figure, before), joints_of(figure, s), joints_of(figure, after), kMoment_s);
  expect_no_skating(figure, s, after);
}

class EveryAction : public ::testing::TestWithParam<Action> {};
INSTANTIATE_TEST_SUITE_P(People, EveryAction, ::testing::ValuesIn(kAll),
                         [](const auto& test) { return std::string(name_of(test.param)); });

TEST_P(EveryAction, KeepsBonesLimitsAndGround) {
  const std::array<Action, 1> allowed{GetParam()};
  for (std::uint32_t clip = 0; clip < clips() / kActions; ++clip) {
    const Crowd crowd = crowd_of(stage_of(allowed), 1, 7, clip);
    for (double t = 0.01; t < kSeconds; t += 0.137) {
      ASSERT_NO_FATAL_FAILURE(expect_body_holds(*crowd.people()[0], t)) << "clip " << clip << " at " << t;
    }
  }
}

TEST(People, KeepApartAndOnTheirStage) {
  for (std::uint32_t clip = 0; clip < clips() / 3; ++clip) {
    Stage stage = stage_of(std::span(kAll).first(9));  // who falls needs more room than three have
    stage.obstacles = {{0, 0, 0.8, 0.6}};
    const Crowd crowd = crowd_of(stage, 1 + clip % 3, 3, clip);
    const auto people = crowd.people();
    ASSERT_EQ(people.size(), 1 + clip % 3);
    for (double t = 0; t <= kSeconds; t += 0.5)
      for (std::size_t i = 0; i < people.size(); ++i) {
        const Vec3 p = people[i]->at(t).pelvis;
        ASSERT_TRUE(stage.area.holds(p, kInside_m - 0.05)) << clip;
        ASSERT_FALSE(stage.obstacles[0].holds(p, -kOffObstacle_m + 0.05)) << clip;
        for (std::size_t k = 0; k < i; ++k)
          ASSERT_GT(glm::distance(p, people[k]->at(t).pelvis), kApart_m - 0.1) << clip << " at " << t;
      }
  }
}

TEST(People, KeepApartForMinutes) {
  Stage stage = stage_of(std::array{Action::walk});
  Crowd crowd(stage, 2, 11, 0);
  crowd.plan_until(120);
  double way_m = 0;
  Vec3 last = crowd.people()[0]->at(0).pelvis;
  for (double t = 0; t <= 120; t += 0.25) {
    const Vec3 p = crowd.people()[0]->at(t).pelvis, q = crowd.people()[1]->at(t).pelvis;
    ASSERT_GT(std::hypot(p.x - q.x, p.y - q.y), kApart_m - 0.1) << t;
    way_m += glm::distance(p, last);
    last = p;
  }
  EXPECT_GT(way_m, 20) << "and they do walk";
}

TEST(People, AreTheSameForTheSameSeedAndClip) {
  const Crowd once = crowd_of(stage_of(kAll), 3, 5, 9), other = crowd_of(stage_of(kAll), 3, 5, 10);
  Crowd again(stage_of(kAll), 3, 5, 9);
  for (double t = 0; t <= kSeconds; t += 0.3) again.plan_until(t);  // bit by bit
  for (std::size_t i = 0; i < 3; ++i) {
    EXPECT_EQ(once.people()[i]->at(2.5).hands, again.people()[i]->at(2.5).hands);
    EXPECT_NE(once.people()[i]->at(2.5).hands, other.people()[i]->at(2.5).hands);
  }
}

TEST(People, WhoSitsOnAChairStaysThere) {
  Stage stage = stage_of(kAll);
  stage.allowed = {Action::sit};
  stage.chairs = true;
  Crowd crowd(stage, 1, 2, 0);
  crowd.plan_until(30);
  const auto people = crowd.people();
  ASSERT_TRUE(people[0]->chair().has_value());
  double lowest = 9;
  for (double t = 0; t < 30; t += 0.1) {
    const Vec3 p = people[0]->at(t).pelvis;
    EXPECT_LT(std::hypot(p.x - people[0]->chair()->seat.x, p.y - people[0]->chair()->seat.y), 0.4);
    lowest = std::min(lowest, p.z);
  }
  EXPECT_NEAR(lowest, kSeat_m + 0.05 * people[0]->figure().stature_m, 0.01);
}

// Known answers, one action each.

struct Actor {
  Score score{Figure(1.7), {2, 1.75, 0}, 0.4};
  CounterRng rng{1, Purpose::persons, 0, 0, 0};
  Stance at(double t_s) const { return stance_of(score.figure, score.at(t_s)); }
};

TEST(Walk, EndsAtItsGoalOnBothFeet) {
  Actor actor;
  const double end_s = add_walk(actor.score, 0, {3.2, 2.4, 0}, actor.rng);
  const Stance s = actor.at(end_s);
  EXPECT_NEAR(s.pelvis.x, 3.2, 1e-9);
  EXPECT_NEAR(s.pelvis.y, 2.4, 1e-9);
  EXPECT_NEAR(glm::distance(s.ankles[kLeft], s.ankles[kRight]), 2 * actor.score.figure.half_hips_m(), 1e-9);
  EXPECT_NEAR(s.ankles[kLeft].z, actor.score.figure.ankle_height_m(), 1e-12);
}

TEST(Walk, SteadyStepsAreThoseOfTheGait) {
  Actor actor;
  add_walk(actor.score, 0, Vec3{2, 1.75, 0} + 30.0 * Vec3{std::cos(0.4), std::sin(0.4), 0}, actor.rng);
  const Travel& travel = actor.score.travels.back();
  const Gait gait(actor.score.figure, travel.cruise_m_s);
  // Two strikes of a foot lie one stride apart.
  std::vector<double> strikes;
  bool was_up = false;
  for (double t = 5; t < 12; t += 1e-3) {
    const auto foot = actor.score.feet[kLeft].at(t, 1.7);
    if (was_up && foot.flat)
      strikes.push_back(glm::distance(foot.ankle, actor.score.travels[0].course.start));
    was_up = !foot.flat;
  }
  ASSERT_GT(strikes.size(), 3u);
  for (std::size_t i = 1; i < strikes.size(); ++i)
    EXPECT_NEAR(strikes[i] - strikes[i - 1], gait.stride_m, 0.01 * gait.stride_m);
}

TEST(Turn, TurnsByWhatItWasAsked) {
  Actor actor;
  const double end_s = add_turn(actor.score, 0, -2.0, actor.rng);
  const Stance s = actor.at(end_s);
  EXPECT_NEAR(std::atan2(s.pelvis_forward.y, s.pelvis_forward.x), 0.4 - 2.0, 1e-9);
  EXPECT_NEAR(glm::dot(s.toes[kRight], s.pelvis_forward), 1, 1e-9);
}

TEST(RaiseArms, HandsAreAboveTheHead) {
  Actor actor;
  const double end_s = add_raise_arms(actor.score, 0, actor.rng);
  double highest = 0;
  for (double t = 0; t < end_s; t += 0.02)
    highest = std::max({highest, actor.at(t).hands[kLeft].z, actor.at(t).hands[kRight].z});
  EXPECT_GT(highest, 1.7 * 1.1);
  EXPECT_LT(actor.at(end_s).hands[kLeft].z, 0.9);
}

TEST(Squat, HipsGoDownByWhatIsWritten) {
  Actor actor;
  const double end_s = add_squat(actor.score, 0, actor.rng);
  double lowest = 9;
  for (double t = 0; t < end_s; t += 0.02) lowest = std::min(lowest, actor.at(t).pelvis.z);
  EXPECT_GT(lowest, 0.29 * 1.7);
  EXPECT_LT(lowest, 0.36 * 1.7);
}

TEST(Bend, TheHeadComesDownAndTheFeetStay) {
  Actor actor;
  const Stance before = actor.at(0);
  const double end_s = add_bend(actor.score, 0, actor.rng);
  double lowest = 9;
  for (double t = 0; t < end_s; t += 0.02) {
    lowest = std::min(lowest, actor.at(t).neck.z);
    ASSERT_EQ(actor.at(t).ankles, before.ankles);
  }
  EXPECT_LT(lowest, 0.75 * before.neck.z);
  EXPECT_NEAR(actor.at(end_s).neck.z, before.neck.z, 1e-6);
}

TEST(Fall, EndsLying) {
  for (std::uint16_t way = 0; way < 12; ++way) {
    Actor actor;
    actor.rng = CounterRng(1, Purpose::persons, way, 0, 0);
    const Stance s = actor.at(add_fall(actor.score, 0, actor.rng));
    EXPECT_NEAR(s.pelvis.z, 0.12 * 1.7, 0.02);
    EXPECT_LT(s.neck.z, 0.35);
    EXPECT_GT(glm::distance(s.neck, s.ankles[kLeft]), 0.65 * 1.7) << "stretched out";
  }
}

}  // namespace
}  // namespace csipose::sim
