// What one pose is worth beside another: closed forms and invariances.
#include "model/pose_errors.h"

#include "tests/model/made_up_poses.h"

namespace csipose {
namespace {

using testing::leaning;
using testing::moved;
using testing::some_pose;
using testing::standing_person;

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

}  // namespace
}  // namespace csipose
