// A set's profile: counts, amplitudes, bones and axes of windows whose answers are known.
#include "train/profile.h"

#include <cmath>

#include "proto/window.h"

namespace csipose::train {
namespace {

/// Stands at (x, y), looks along (cos, sin) of `heading_rad`, knees bent forward; z up, left = up x forward.
Skeleton standing(float x, float y, float heading_rad, float bend_m) {
  struct JointPlace {
    float left, forward, up;
  };
  constexpr float kShoulder = 0.161f, kHip = 0.0845f;
  const std::array<JointPlace, kJoints> places = {{{0, 0, 1.5f},
                                                   {0, 0, 1.579f},
                                                   {kShoulder, 0, 1.5f},
                                                   {-kShoulder, 0, 1.5f},
                                                   {kShoulder, 0, 1.231f},
                                                   {kHip, 0, .9f},
                                                   {-kShoulder, 0, 1.231f},
                                                   {-kHip, 0, .9f},
                                                   {kShoulder, 0, .938f},
                                                   {kHip, bend_m, .5f},
                                                   {-kShoulder, 0, .938f},
                                                   {-kHip, bend_m, .5f},
                                                   {kHip, 0, .1f},
                                                   {-kHip, 0, .1f}}};
  const float c = std::cos(heading_rad), s = std::sin(heading_rad);
  Skeleton pose;
  for (std::size_t j = 0; j < kJoints; ++j) {
    const auto& [left, forward, up] = places[j];
    pose[j] = {x + c * forward - s * left, y + s * forward + c * left, up};
  }
  return pose;
}
Skeleton changed(Skeleton pose, float x, float y, float z) {
  for (Point3& joint : pose) joint = {x * joint.x, y * joint.y, z * joint.z + 1};
  return pose;
}
/// Link l has the amplitude l + 1 in every window.
std::vector<float> amplitudes() {
  std::vector<float> x(kChannels * kTokens, 9);
  for (std::size_t k = 0; k < kSubcarriers; ++k)
    for (std::size_t t = 0; t < kSamples; ++t)
      for (std::size_t l = 0; l < kLinks; ++l) x[Window::index(k, t, l)] = static_cast<float>(l + 1);
  return x;
}
Profile of_people(float x, float y, float z, float bend_m) {
  Profile profile({"published", true, {}});
  for (int i = 0; i < 20; ++i) {
    const std::vector<Skeleton> people = {
        changed(standing(1, 2, 0.3f * static_cast<float>(i), bend_m), x, y, z)};
    profile.add({amplitudes(), 1101, {}, people});
  }
  return profile;
}

TEST(Profile, CountsBySceneAndPeopleAndMeansOfLinks) {
  Profile profile({"published", true, {}});
  const std::vector<Skeleton> two(2), one(1);
  profile.add({amplitudes(), 1101, 0, one});
  profile.add({amplitudes(), 1203, 0, two});
  profile.add({amplitudes(), 5240, 0, two});
  ASSERT_EQ(profile.groups().size(), 2u);
  const ProfileGroup& scene = profile.groups().at("scene 1");
  EXPECT_EQ(scene.windows, 2u);
  EXPECT_EQ(scene.by_people.at(1), 1u);
  EXPECT_EQ(scene.by_people.at(2), 1u);
  for (std::size_t l = 0; l < kLinks; ++l)
    EXPECT_DOUBLE_EQ(scene.mean_amplitude(l), static_cast<double>(l + 1));
  EXPECT_EQ(profile.people(), 5u);
  EXPECT_NE(profile.describe().find("scene 5"), std::string::npos);
}

TEST(Profile, GroupsByRoomWhereTheSetIsNotThePublishedOne) {
  Profile profile({"simulated", true, {{0, "office"}}});
  profile.add({amplitudes(), 1101, 0, {}});
  profile.add({amplitudes(), 1101, 3, {}});
  profile.add({amplitudes(), 1101, {}, {}});
  EXPECT_TRUE(profile.groups().contains("office"));
  EXPECT_TRUE(profile.groups().contains("room3"));
  EXPECT_TRUE(profile.groups().contains("all"));
}

TEST(Profile, BonesBesideThePublishedOnes) {
  const Profile profile = of_people(1, 1, 1, 0);
  EXPECT_NEAR(profile.mean_length_m(0, 1), 0.079, 1e-5);
  EXPECT_NEAR(profile.mean_length_m(2, 3), 0.322, 1e-5);
  EXPECT_NEAR(profile.mean_length_m(4, 8), 0.293, 1e-5);
  EXPECT_NE(profile.describe().find("neck - head                        0.079      0.079"), std::string::npos)
      << profile.describe();
  EXPECT_TRUE(std::isnan(Profile({"published", true, {}}).mean_length_m(0, 1)));
}

struct AxesCase {
  float x, y, z;
  double up, left;
  const char* words;
};
TEST(Profile, AxesAreToldByBodies) {
  for (const AxesCase& is : {AxesCase{1, 1, 1, 1, 1, "label to room is diag(1, 1, 1)"},
                             AxesCase{1, 1, -1, -1, 1, "label to room is diag(1, 1, -1)"},
                             AxesCase{-1, 1, -1, -1, 0, "label to room is diag(1, -1, -1)"},
                             AxesCase{1, -1, 1, 1, 0, "label to room is diag(1, -1, 1)"}}) {
    const Profile profile = of_people(is.x, is.y, is.z, 0.1f);
    EXPECT_EQ(profile.axes().up, is.up);
    EXPECT_EQ(profile.axes().left, is.left);
    EXPECT_EQ(profile.axes().bent, 20u);
    EXPECT_EQ(profile.axes().left_of_bent, is.left);
    EXPECT_NE(profile.describe().find(is.words), std::string::npos) << profile.describe();
  }
}

TEST(Profile, SaysWhatItCannotTell) {
  Profile unlabelled({"recording", false, {}});
  unlabelled.add({amplitudes(), 0, {}, {}});
  EXPECT_NE(unlabelled.describe().find("no labels"), std::string::npos);
  Profile both({"published", true, {}});  // as many one way as the other
  for (const float y : {1.f, -1.f}) {
    const std::vector<Skeleton> people = {changed(standing(1, 2, 0, 0.1f), 1, y, 1)};
    both.add({amplitudes(), 1101, {}, people});
  }
  EXPECT_NE(both.describe().find("tells nothing"), std::string::npos);
}

}  // namespace
}  // namespace csipose::train
