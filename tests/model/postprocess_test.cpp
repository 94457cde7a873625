#include "model/postprocess.h"

#include <gtest/gtest.h>

#include <cmath>

namespace csipose {
namespace {

/// An answer of the network, written by hand.
struct Answer {
  void add(float logit, float x_m) {
    logits.push_back(logit);
    for (std::size_t j = 0; j < kJoints; ++j) poses.insert(poses.end(), {x_m, 0, static_cast<float>(j)});
  }
  NetworkOutput output() const { return {logits, poses, sigma_m}; }
  std::vector<float> logits, poses, sigma_m;
};

std::shared_ptr<const Model> plain_model() {
  static const auto model = init_random(preset_config("micro"), 1, HeadInit::zero);
  return model;
}

class Select : public ::testing::Test {
 protected:
  Selected run(const Answer& answer, const Selection& selection = {}) {
    return select_people(answer.output(), *plain_model(), selection, people);
  }
  std::array<Person, kMaxPeople> people;
};

TEST_F(Select, BestFirstAboveTheThreshold) {
  Answer answer;
  answer.add(0.1f, 1);
  answer.add(-0.1f, 2);
  answer.add(3, 3);
  ASSERT_EQ(run(answer).count, 2u);
  EXPECT_EQ(people[0].joints[5].x, 3);
  EXPECT_NEAR(people[0].score, 1 / (1 + std::exp(-3.0)), 1e-6);
  EXPECT_EQ(people[1].joints[5].x, 1);
  EXPECT_EQ(people[1].joints_raw[13].z, 13);
  EXPECT_EQ(run(answer).query[0], 2u);
  EXPECT_EQ(run(answer).query[1], 0u);
}

TEST_F(Select, OfTwoNearPosesTheBetterStays) {
  Answer answer;
  answer.add(1, 0);
  answer.add(2, 0.2f);  // suppresses 0 and nothing else
  answer.add(1.5f, 0.46f);
  answer.add(0.5f, 0.7f);  // near to the one at 0.46
  ASSERT_EQ(run(answer).count, 2u);
  EXPECT_EQ(people[0].joints[0].x, 0.2f);
  EXPECT_EQ(people[1].joints[0].x, 0.46f);
  EXPECT_EQ(run(answer, {5, 0.5f, 0}).count, 4u);
}

TEST_F(Select, ASuppressedPoseSuppressesNobody) {
  Answer answer;
  answer.add(3, 0);
  answer.add(2, 0.2f);
  answer.add(1, 0.4f);  // near to the suppressed one only
  EXPECT_EQ(run(answer).count, 2u);
}

TEST_F(Select, AtMostSoManyPeople) {
  Answer answer;
  for (int i = 0; i < 20; ++i) answer.add(static_cast<float>(i), static_cast<float>(i));
  EXPECT_EQ(run(answer, {3, 0.5f, 0.25f}).count, 3u);
  EXPECT_EQ(people[2].joints[0].x, 17);
  EXPECT_EQ(run(answer, {100, 0.5f, 0.25f}).count, kMaxPeople);
}

TEST_F(Select, EqualScoresGoToTheEarlierQuery) {
  Answer answer;
  answer.add(1, 5);
  answer.add(1, 5.1f);
  ASSERT_EQ(run(answer).count, 1u);
  EXPECT_EQ(people[0].joints[0].x, 5);
}

TEST_F(Select, AnAnswerThatIsNotFiniteGivesNobody) {
  for (const float bad : {NAN, HUGE_VALF}) {
    Answer answer;
    answer.add(3, 1);
    answer.add(-9, 2);
    answer.poses[60] = bad;
    const Selected selected = run(answer);
    EXPECT_EQ(selected.count, 0u);
    EXPECT_TRUE(selected.not_finite);
  }
  Answer answer;
  answer.add(NAN, 1);
  EXPECT_TRUE(run(answer).not_finite);
}

TEST_F(Select, WithoutASigmaHeadConfidenceIsUnknown) {
  Answer answer;
  answer.add(3, 1);
  ASSERT_EQ(run(answer).count, 1u);
  for (std::size_t j = 0; j < kJoints; ++j) {
    EXPECT_TRUE(std::isnan(people[0].confidence[j]));
    EXPECT_TRUE(std::isnan(people[0].sigma_m[j]));
  }
}

TEST_F(Select, SigmaBelongsToItsQuery) {
  Answer answer;
  answer.add(-9, 1);
  answer.add(3, 2);
  for (int i = 0; i < 28; ++i) answer.sigma_m.push_back(0.01f * static_cast<float>(i + 1));
  ASSERT_EQ(run(answer).count, 1u);
  EXPECT_FLOAT_EQ(people[0].sigma_m[0], 0.15f);
  EXPECT_NEAR(people[0].confidence[0], 1 - std::exp(-1.0), 1e-6);
}

TEST(Scores, PlattScalingReplacesTheSigmoid) {
  Calibration calibration;
  EXPECT_FLOAT_EQ(person_score(0, calibration), 0.5f);
  calibration.score = PlattScaling{2, -1};
  EXPECT_FLOAT_EQ(person_score(0.5f, calibration), 0.5f);
  EXPECT_FLOAT_EQ(person_score(1.5f, calibration), static_cast<float>(1 / (1 + std::exp(-2.0))));
  EXPECT_EQ(person_score(-1e30f, calibration), 0.f);
}

TEST(Scores, ExpectedErrorTakesTheJointsFactor) {
  Calibration calibration;
  EXPECT_EQ(expected_error_m(0.1f, 3, calibration), 0.1f);
  calibration.joint_scale.emplace();
  (*calibration.joint_scale)[3] = 2;
  EXPECT_EQ(expected_error_m(0.1f, 3, calibration), 0.2f);
}

TEST(Scores, ConfidenceCurveIsLinearBetweenKnotsAndConstantOutside) {
  Calibration calibration;
  calibration.confidence.emplace();
  for (std::size_t i = 0; i < kConfidenceKnots; ++i) {
    calibration.confidence->raw[i] = 0.2f + 0.03f * static_cast<float>(i);
    calibration.confidence->corrected[i] = 0.1f + 0.04f * static_cast<float>(i);
  }
  const auto sigma_for = [](double raw) { return static_cast<float>(-0.15 / std::log(1 - raw)); };
  EXPECT_NEAR(joint_confidence(sigma_for(0.215), calibration), 0.12, 1e-5);
  EXPECT_NEAR(joint_confidence(sigma_for(0.05), calibration), 0.1, 1e-6);
  EXPECT_NEAR(joint_confidence(sigma_for(0.99), calibration), 0.1 + 0.04 * 19, 1e-6);
}

TEST(Room, TransformTurnsMirrorsAndShifts) {
  const RoomTransform quarter_turn = {{{0, -1, 0, 10}, {1, 0, 0, 20}, {0, 0, -1, 30}}};
  const float p[3] = {1, 2, 3};
  const Point3 room = to_room(quarter_turn, p);
  EXPECT_EQ(room.x, 8);
  EXPECT_EQ(room.y, 21);
  EXPECT_EQ(room.z, 27);
}

}  // namespace
}  // namespace csipose
