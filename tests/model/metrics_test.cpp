// The figures by which methods are compared: closed forms, invariances, and the golden frames.
#include "model/metrics.h"

#include <cmath>
#include <nlohmann/json.hpp>
#include <numbers>

#include "tests/shared_data.h"

namespace csipose {
namespace {

Skeleton some_pose(unsigned seed) {
  std::mt19937 random(seed);
  std::normal_distribution<float> spread(0, 0.4f);
  Skeleton pose;
  for (Point3& joint : pose) joint = {spread(random), spread(random), spread(random)};
  return pose;
}
Skeleton moved(Skeleton pose, Point3 by) {
  for (Point3& joint : pose) joint = {joint.x + by.x, joint.y + by.y, joint.z + by.z};
  return pose;
}

TEST(PoseErrors, OfAShift) {
  const Skeleton person = some_pose(1);
  const PoseErrors errors = pose_errors(moved(person, {0.03f, -0.04f, 0}), person);
  EXPECT_NEAR(errors.mpjpe, 50, 1e-3);
  EXPECT_NEAR(errors.axis[0], 30, 1e-3);
  EXPECT_NEAR(errors.axis[1], 40, 1e-3);
  EXPECT_NEAR(errors.axis[2], 0, 1e-3);
  EXPECT_NEAR(errors.mrpe, 50, 1e-3);
  EXPECT_NEAR(errors.root_mpjpe, 0, 1e-3);
  EXPECT_NEAR(errors.pa_mpjpe, 0, 1e-3);
  EXPECT_NEAR(errors.facing_deg, 0, 0.05);
  EXPECT_NEAR(errors.breadth_mm, 0, 1e-3);
  EXPECT_EQ(errors.pck20mm, 0);
}

/// Shoulders 0.4 m and hips 0.2 m across, along `right`; all else above and below the root.
Skeleton facing(Point3 right) {
  Skeleton pose;
  for (std::size_t j = 0; j < kJoints; ++j) pose[j] = {2, 1, 0.1f * static_cast<float>(j)};
  const auto aside = [&](std::size_t joint, float metres, float height_m) {
    pose[joint] = {2 + metres * right.x, 1 + metres * right.y, height_m + metres * right.z};
  };
  aside(kLeftShoulder, -0.2f, 1.4f), aside(kRightShoulder, 0.2f, 1.4f);
  aside(kLeftHip, -0.1f, 0.9f), aside(kRightHip, 0.1f, 0.9f);
  return pose;
}

TEST(PoseErrors, OfATurn) {
  const Skeleton person = facing({1, 0, 0});
  for (const float degrees : {0.f, 30.f, 90.f, 135.f, 180.f}) {
    const float radians = degrees * static_cast<float>(std::numbers::pi) / 180;
    const PoseErrors errors = pose_errors(facing({std::cos(radians), std::sin(radians), 0}), person);
    EXPECT_NEAR(errors.facing_deg, degrees, 0.05);
    EXPECT_NEAR(errors.breadth_mm, 0, 1e-3);
    EXPECT_NEAR(errors.mrpe, 0, 1e-3);
    const double chord = 2 * std::sin(radians / 2);  // of a turn by a radius of 1
    EXPECT_NEAR(errors.root_mpjpe, 1000 * (2 * 0.2 + 2 * 0.1) * chord / kJoints, 1e-3);
    EXPECT_NEAR(errors.mpjpe, errors.root_mpjpe, 1e-3);
  }
}

TEST(PoseErrors, AStickFacesNowhere) {
  const PoseErrors errors = pose_errors(facing({0, 0, 0}), facing({0, 1, 0}));
  EXPECT_EQ(errors.facing_deg, 90);
  EXPECT_NEAR(errors.breadth_mm, -300, 1e-3);
  EXPECT_NEAR(pose_errors(facing({0, 0.5f, 0}), facing({0, 1, 0})).breadth_mm, -150, 1e-3);
}

/// Who stands upright, z up, arms hanging.
Skeleton standing_person() {
  return {{{0, 0, 1.45f},       // neck
           {0, 0, 1.65f},       // head
           {-0.2f, 0, 1.4f},    // shoulders
           {0.2f, 0, 1.4f},     //
           {-0.22f, 0, 1.1f},   // left elbow
           {-0.1f, 0, 0.9f},    // left hip
           {0.22f, 0, 1.1f},    // right elbow
           {0.1f, 0, 0.9f},     // right hip
           {-0.22f, 0, 0.85f},  // left hand
           {-0.1f, 0, 0.5f},    // left knee
           {0.22f, 0, 0.85f},   // right hand
           {0.1f, 0, 0.5f},     // right knee
           {-0.1f, 0, 0.08f},   // ankles
           {0.1f, 0, 0.08f}}};
}
/// Neck, head and arms turned forward (y) about the hips' line.
Skeleton leaning(Skeleton pose, float degrees) {
  const float radians = degrees * static_cast<float>(std::numbers::pi) / 180;
  for (const std::size_t joint : {0, 1, 2, 3, 4, 6, 8, 10}) {
    const float up = pose[joint].z - 0.9f;
    pose[joint].y = std::sin(radians) * up, pose[joint].z = 0.9f + std::cos(radians) * up;
  }
  return pose;
}

TEST(PostureOf, FirstThatFits) {
  const Skeleton upright = standing_person();
  EXPECT_EQ(posture_of(upright), Posture::upright);
  EXPECT_EQ(posture_of(leaning(upright, 38)), Posture::upright);
  EXPECT_EQ(posture_of(leaning(upright, 42)), Posture::bent);

  Skeleton reaching = upright;
  reaching[10] = {0.3f, 0, 1.44f};  // right hand
  EXPECT_EQ(posture_of(reaching), Posture::upright) << "not above the neck";
  reaching[10].z = 1.46f;
  EXPECT_EQ(posture_of(reaching), Posture::arms_raised);
  EXPECT_EQ(posture_of(leaning(reaching, 60)), Posture::bent);

  Skeleton sitting = reaching;
  for (Point3& joint : sitting) joint.z -= 0.4f;
  for (const std::size_t knee : {9, 11}) sitting[knee] = {sitting[knee].x, 0.4f, 0.5f};
  for (const std::size_t ankle : {12, 13}) sitting[ankle] = {sitting[ankle].x, 0.4f, 0.08f};
  EXPECT_EQ(posture_of(sitting), Posture::low) << "0.58 m of legs of 0.82 m";
}

TEST(PostureOf, IsToldInAnyFrame) {
  for (const Skeleton& pose : {standing_person(), leaning(standing_person(), 60)}) {
    Skeleton turned;
    for (std::size_t j = 0; j < kJoints; ++j) turned[j] = {pose[j].z + 3, -pose[j].x, -pose[j].y};
    EXPECT_EQ(posture_of(turned), posture_of(pose));
  }
}

TEST(PoseErrors, WithinIsInclusive) {
  Skeleton person{};
  person[0].x = 0.25f;
  EXPECT_EQ(pose_errors(Skeleton{}, Skeleton{}).pck20, 100) << "nothing is off by nothing";
  person[3].z = 1;  // right shoulder: the torso is 1 m
  Skeleton predicted = person;
  predicted[1].y = 0.5f;
  EXPECT_EQ(pose_errors(predicted, person).pck50, 100);
  EXPECT_NEAR(pose_errors(predicted, person).pck20, 100. * 13 / 14, 1e-9);
}

TEST(Aligned, UndoesTurnScaleAndMoveButNoMirror) {
  const Skeleton person = some_pose(2);
  Skeleton turned, mirrored = person;
  const float c = std::cos(2.f), s = std::sin(2.f);
  for (std::size_t j = 0; j < kJoints; ++j) {
    const Point3& p = person[j];
    turned[j] = {1.7f * (c * p.x - s * p.y) + 3, 1.7f * (s * p.x + c * p.y) - 1, 1.7f * p.z};
    mirrored[j].x = -p.x;
  }
  EXPECT_LT(pose_errors(turned, person).pa_mpjpe, 1e-3);
  EXPECT_GT(pose_errors(mirrored, person).pa_mpjpe, 50);
}

TEST(Aligned, APointIsOnlyMoved) {
  const Skeleton person = some_pose(3);
  const Skeleton point = aligned(moved(Skeleton{}, {5, 5, 5}), person);
  for (const Point3& joint : point) EXPECT_EQ(joint.x, point[0].x);
  EXPECT_LT(std::abs(point[0].x), 1);
}

TEST(Match, GreedyTakesTheNearestPairFirstAndOptimalTheLeastSum) {
  const std::vector<Skeleton> people = {Skeleton{}, moved(Skeleton{}, {0.3f, 0, 0})};
  const std::vector<Skeleton> predicted = {moved(Skeleton{}, {0.2f, 0, 0}), moved(Skeleton{}, {0.45f, 0, 0})};
  EXPECT_EQ(match(Protocol::piw3d, predicted, people), (std::vector<std::size_t>{1, 0}));
  EXPECT_EQ(match(Protocol::detect, predicted, people), (std::vector<std::size_t>{0, 1}));
  EXPECT_EQ(match(Protocol::assigned, predicted, people), (std::vector<std::size_t>{0, 1}));
}

TEST(Match, FixedAnswersAreAssignedHoweverFar) {
  const std::vector<Skeleton> people = {Skeleton{}, moved(Skeleton{}, {3, 0, 0})};
  const std::vector<Skeleton> fixed(2, moved(Skeleton{}, {-9, 0, 0}));
  EXPECT_EQ(match(Protocol::assigned, fixed, people), (std::vector<std::size_t>{0, 1}));
  EXPECT_EQ(match(Protocol::detect, fixed, people), (std::vector<std::size_t>{kMissed, kMissed}));
}

TEST(Match, TooFewPredictions) {
  const std::vector<Skeleton> people = {Skeleton{}, moved(Skeleton{}, {3, 0, 0})};
  const std::vector<Skeleton> one = {Skeleton{}};
  EXPECT_EQ(match(Protocol::piw3d, one, people), (std::vector<std::size_t>{0, 0}));
  EXPECT_EQ(match(Protocol::detect, one, people), (std::vector<std::size_t>{0, kMissed}));
  EXPECT_EQ(match(Protocol::assigned, one, people), (std::vector<std::size_t>{0, kMissed}));
  EXPECT_EQ(match(Protocol::piw3d, {}, people), (std::vector<std::size_t>{kMissed, kMissed}));
}

TEST(Metrics, CountsWhoWasMissedAndWhoWasMadeUp) {
  Metrics metrics(Protocol::detect);
  const std::vector<Skeleton> here = {Skeleton{}}, there = {moved(Skeleton{}, {2, 0, 0})};
  metrics.add(here, here);
  metrics.add(there, here);
  metrics.add({}, {});
  const GroupMetrics all = metrics.all();
  EXPECT_EQ(all.frames, 3u);
  EXPECT_EQ(all.frames_unmatched, 1u);
  EXPECT_EQ(all.frame_mean.mpjpe, 0);
  EXPECT_EQ(all.penalised_500, 250);
  EXPECT_EQ(all.precision(), 0.5);
  EXPECT_EQ(all.recall(), 0.5);
  EXPECT_EQ(all.count_accuracy(), 1);
  EXPECT_EQ(metrics.by_count().at(0).frames, 1u);
  EXPECT_TRUE(nlohmann::json::parse(metrics_json(metrics))["by_count"]["0"]["mpjpe"].is_null());
}

TEST(Metrics, ByPosture) {
  Metrics metrics(Protocol::detect);
  const Skeleton upright = standing_person(), bent = leaning(upright, 60);
  metrics.add(std::vector{moved(upright, {0.1f, 0, 0})}, std::vector{upright});
  metrics.add(std::vector{upright}, std::vector{upright, moved(bent, {3, 0, 0})});
  EXPECT_EQ(metrics.by_posture(Posture::upright).people, 2u);
  EXPECT_EQ(metrics.by_posture(Posture::upright).matched, 2u);
  EXPECT_NEAR(metrics.by_posture(Posture::upright).person_mean.mpjpe, 50, 1e-3);
  EXPECT_EQ(metrics.by_posture(Posture::bent).people, 1u);
  EXPECT_EQ(metrics.by_posture(Posture::bent).matched, 0u);
  const auto json = nlohmann::json::parse(metrics_json(metrics))["by_posture"];
  EXPECT_EQ(json["upright"]["recall"], 1);
  EXPECT_TRUE(json["bent"]["mpjpe"].is_null());
  EXPECT_EQ(json["low"]["people"], 0);
}

std::vector<Skeleton> skeletons(const nlohmann::json& poses) {
  std::vector<Skeleton> result;
  for (const nlohmann::json& pose : poses) {
    Skeleton& skeleton = result.emplace_back();
    for (std::size_t j = 0; j < kJoints; ++j) skeleton[j] = {pose[j][0], pose[j][1], pose[j][2]};
  }
  return result;
}

void expect_errors(const PoseErrors& found, const nlohmann::json& expected, const std::string& where) {
  EXPECT_NEAR(found.mpjpe, expected["mpjpe"], 0.01) << where;
  EXPECT_NEAR(found.axis[0], expected["h"], 0.01) << where;
  EXPECT_NEAR(found.axis[1], expected["v"], 0.01) << where;
  EXPECT_NEAR(found.axis[2], expected["d"], 0.01) << where;
  EXPECT_NEAR(found.pa_mpjpe, expected["pa"], 0.01) << where;
  EXPECT_NEAR(found.pck20, expected["pck20_torso"], 0.01) << where;
  EXPECT_NEAR(found.pck50, expected["pck50_torso"], 0.01) << where;
  EXPECT_NEAR(found.pck20_elbows, expected["pck20_dtpose"], 0.01) << where;
  EXPECT_NEAR(found.pck50_elbows, expected["pck50_dtpose"], 0.01) << where;
  EXPECT_NEAR(found.pck20mm, expected["pck20mm"], 0.01) << where;
  EXPECT_NEAR(found.pck50mm, expected["pck50mm"], 0.01) << where;
}

void expect_group(const GroupMetrics& found, const nlohmann::json& expected, const std::string& where) {
  EXPECT_EQ(found.frames, expected["frames"]) << where;
  expect_errors(found.frame_mean, expected["frame_mean"], where + ", frame mean");
  expect_errors(found.person_mean, expected["person_mean"], where + ", person mean");
  EXPECT_NEAR(found.penalised_500, expected["mpjpe_penalised_500"], 0.01) << where;
  for (std::size_t j = 0; j < kJoints; ++j)
    EXPECT_NEAR(found.per_joint[j], expected["per_joint_mpjpe"][j], 0.01) << where << ", joint " << j;
}

void expect_golden(Protocol protocol, const std::string& name, float min_score) {
  const auto read = [](const std::string& file) {
    std::ifstream in(testing::shared_data("model/metrics/" + file));
    return nlohmann::json::parse(in);
  };
  Metrics metrics(protocol);
  for (const nlohmann::json& frame : read("frames.json")) {
    const std::vector<Skeleton> all = skeletons(frame["pred"]);
    std::vector<Skeleton> kept;
    for (std::size_t i = 0; i < all.size(); ++i)
      if (frame["score"][i].get<float>() >= min_score) kept.push_back(all[i]);
    metrics.add(kept, skeletons(frame["gt"]));
  }
  const nlohmann::json expected = read("expected_" + name + ".json");
  expect_group(metrics.all(), expected["all"], name);
  for (const auto& [count, group] : metrics.by_count())
    expect_group(group, expected["by_count"][std::to_string(count)],
                 fmt::format("{}, {} people", name, count));
}

TEST(Metrics, GoldenFrames) {
  CSIPOSE_NEEDS_SHARED_DATA();
  expect_golden(Protocol::piw3d, "piw3d", 0);
  expect_golden(Protocol::detect, "detect", 0.3f);
}

}  // namespace
}  // namespace csipose
