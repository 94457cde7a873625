#include "model/tracker.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <map>
#include <random>
#include <vector>

#include "tests/counting_allocator.h"

namespace csipose {
namespace {

using std::chrono::milliseconds;
constexpr milliseconds kStep{33};

SteadyTime at(milliseconds t) { return SteadyTime{std::chrono::seconds(5) + t}; }

/// Somebody of 1.7 m standing at (x, y): joints on a line up, which is all that a tracker sees of a person.
Person standing(double x_m, double y_m) {
  Person person;
  for (std::size_t j = 0; j < kJoints; ++j)
    person.joints[j] = {static_cast<float>(x_m), static_cast<float>(y_m),
                        0.1f + 0.12f * static_cast<float>(j)};
  return person;
}
Person shaken(Person person, std::mt19937& random, float sigma_m) {
  std::normal_distribution<float> noise(0, sigma_m);
  for (Point3& joint : person.joints)
    joint = {joint.x + noise(random), joint.y + noise(random), joint.z + noise(random)};
  return person;
}
std::uint32_t update_one(Tracker& tracker, milliseconds t, const Person& person) {
  std::vector<Person> people = {person};
  tracker.update(at(t), people);
  return people[0].id;
}

TEST(Tracker, OnePersonKeepsTheIdAndAges) {
  Tracker tracker;
  std::vector<Person> people;
  for (int i = 0; i < 60; ++i) {
    people = {standing(1 + 0.03 * i, 2)};
    tracker.update(at(kStep * i), people);
    EXPECT_EQ(people[0].id, 1u);
    EXPECT_EQ(people[0].age_ms, 33u * static_cast<unsigned>(i));
  }
}

TEST(Tracker, NobodyIsAdded) {
  Tracker tracker;
  update_one(tracker, milliseconds(0), standing(1, 1));
  std::vector<Person> nobody;
  tracker.update(at(kStep), nobody);
  EXPECT_TRUE(nobody.empty());
  EXPECT_EQ(tracker.tracks(), 1u);
}

TEST(Tracker, OrderOfDetectionsDoesNotMatter) {
  Tracker tracker;
  std::vector<Person> people = {standing(1, 1), standing(3, 1), standing(2, 3)};
  tracker.update(at(milliseconds(0)), people);
  std::map<std::uint32_t, float> x_of;
  for (const Person& person : people) x_of[person.id] = person.joints[0].x;
  std::reverse(people.begin(), people.end());
  tracker.update(at(kStep), people);
  for (std::size_t i = 0; i < 3; ++i) {
    EXPECT_EQ(people[i].id, i + 1);
    EXPECT_EQ(people[i].joints[0].x, x_of[people[i].id]);
  }
}

// Two people walk along one line in opposite directions and stand in the same place half-way: only speed
// tells them apart.
TEST(Tracker, PeopleWhoCrossKeepTheirIds) {
  std::mt19937 random(3);
  Tracker tracker;
  std::uint32_t walks_right = 0, walks_left = 0;
  for (int i = 0; i <= 120; ++i) {
    const double s = 1.2 * seconds(kStep * i);
    std::vector<Person> people = {shaken(standing(s, 1), random, 0.03f),
                                  shaken(standing(4.8 - s, 1.02), random, 0.03f)};
    const float right_x = people[0].joints[0].x;
    if (i % 2) std::swap(people[0], people[1]);
    tracker.update(at(kStep * i), people);
    const std::size_t right = people[0].joints[0].x == right_x ? 0 : 1;
    if (i == 0) walks_right = people[right].id, walks_left = people[1 - right].id;
    EXPECT_EQ(people[right].id, walks_right) << i;
    EXPECT_EQ(people[1 - right].id, walks_left) << i;
  }
}

TEST(Tracker, WalkerIsFoundAgainWhereTheWalkLedTo) {
  Tracker tracker;
  int i = 0;
  for (; i < 30; ++i) update_one(tracker, kStep * i, standing(1.5 * seconds(kStep * i), 1));
  const auto later = kStep * i + milliseconds(500);
  EXPECT_EQ(update_one(tracker, later, standing(1.5 * seconds(Nanoseconds(later)), 1)), 1u);
}

// The prediction of a steady walk is the walk itself: with a decoy nearer to the old place, the walker keeps
// the id.
TEST(Tracker, SteadyMotionIsPredictedInClosedForm) {
  Tracker tracker;
  int i = 0;
  for (; i < 60; ++i) update_one(tracker, kStep * i, standing(2 * seconds(kStep * i), 1));
  const auto later = kStep * (i - 1) + milliseconds(300);
  const double x_then = 2 * seconds(kStep * (i - 1)), x_now = 2 * seconds(Nanoseconds(later));
  std::vector<Person> people = {standing(x_then + 0.25, 1), standing(x_now, 1)};
  tracker.update(at(later), people);
  EXPECT_EQ(people[0].id, 1u);
  EXPECT_NEAR(people[0].joints[0].x, x_now, 1e-6);
}

TEST(Tracker, TooFarAwayIsSomebodyElse) {
  Tracker tracker;
  EXPECT_EQ(update_one(tracker, milliseconds(0), standing(1, 1)), 1u);
  EXPECT_EQ(update_one(tracker, kStep, standing(1.8, 1)), 2u);
}

TEST(Tracker, AfterTheTimeoutAPersonIsNew) {
  for (const auto& [gap, id] : {std::pair(milliseconds(1000), 1u), std::pair(milliseconds(1001), 2u)}) {
    Tracker tracker;
    update_one(tracker, milliseconds(0), standing(1, 1));
    EXPECT_EQ(update_one(tracker, gap, standing(1, 1)), id);
  }
}

TEST(Tracker, IdsAreNeverUsedAgain) {
  Tracker tracker;
  EXPECT_EQ(update_one(tracker, milliseconds(0), standing(1, 1)), 1u);
  tracker.reset();
  EXPECT_EQ(update_one(tracker, kStep, standing(1, 1)), 2u);
  EXPECT_EQ(update_one(tracker, milliseconds(5000), standing(1, 1)), 3u);
}

TEST(Tracker, AClockThatStepsBackForgetsEverybody) {
  Tracker tracker;
  EXPECT_EQ(update_one(tracker, milliseconds(5000), standing(1, 1)), 1u);
  EXPECT_EQ(update_one(tracker, milliseconds(0), standing(1, 1)), 2u);
  EXPECT_EQ(update_one(tracker, kStep, standing(1, 1)), 2u);
}

TEST(Tracker, TwoIdenticalStartsAreTwoPeople) {
  Tracker tracker;
  std::vector<Person> people = {standing(1, 1), standing(1, 1)};
  tracker.update(at(milliseconds(0)), people);
  EXPECT_EQ(people[0].id, 1u);
  EXPECT_EQ(people[1].id, 2u);
  tracker.update(at(kStep), people);
  EXPECT_EQ(people[0].id, 1u);
  EXPECT_EQ(people[1].id, 2u);
}

TEST(Tracker, SmoothingKeepsTheRawJointsAndQuietensNoise) {
  std::mt19937 random(5);
  Tracker tracker({milliseconds(1000), true});
  double raw_power = 0, smooth_power = 0;
  for (int i = 0; i < 300; ++i) {
    std::vector<Person> people = {shaken(standing(1, 1), random, 0.05f)};
    const Skeleton detected = people[0].joints;
    tracker.update(at(kStep * i), people);
    EXPECT_EQ(people[0].joints_raw[3].x, detected[3].x);
    if (i < 30) continue;
    raw_power += std::pow(people[0].joints_raw[3].x - 1, 2);
    smooth_power += std::pow(people[0].joints[3].x - 1, 2);
  }
  EXPECT_LT(smooth_power, raw_power / 2);
}

TEST(Tracker, WithoutSmoothingJointsAreAsDetected) {
  Tracker tracker;
  for (int i = 0; i < 5; ++i) {
    std::vector<Person> people = {standing(1 + 0.02 * i, 1)};
    const Skeleton detected = people[0].joints;
    tracker.update(at(kStep * i), people);
    EXPECT_EQ(people[0].joints[7].x, detected[7].x);
    EXPECT_EQ(people[0].joints_raw[7].x, detected[7].x);
  }
}

// ---- how surely somebody is there ----

constexpr double kMemory_s = 0.3;
/// Those below 0.35 are followed and not published.
Tracker forgetful(std::size_t most = kMaxPeople) {
  return Tracker({milliseconds(1000), false, milliseconds(300), 0.35f, most});
}
Person scored(double x_m, float score) {
  Person person = standing(x_m, 1);
  person.score = score;
  return person;
}

// One is there from the beginning; another comes into windows 10 to 19, is not seen in 20 to 24, and is in all after that.
TEST(Tracker, AScoreIsTheMeanOverTheLastMoments) {
  Tracker tracker = forgetful();
  const double kept = std::exp(-seconds(kStep) / kMemory_s);
  double expected = 0;
  for (int i = 0; i < 60; ++i) {
    std::vector<Person> people = {scored(1, 0.9f)};
    const bool seen = (i >= 10 && i < 20) || i >= 25;
    if (seen) people.push_back(scored(4, 0.6f));
    expected = kept * expected + (seen ? (1 - kept) * 0.6 : 0);
    const std::size_t published = tracker.update(at(kStep * i), people);
    ASSERT_EQ(published, seen && expected >= 0.35 ? 2u : 1u) << i;
    EXPECT_EQ(people[0].id, 1u);
    EXPECT_NEAR(people[0].score, 0.9, 1e-6);
    if (published == 2) {
      EXPECT_EQ(people[1].id, 2u);
      EXPECT_NEAR(people[1].score, expected, 1e-6);
    }
  }
  EXPECT_NEAR(expected, 0.6, 1e-2);
}

TEST(Tracker, WhoIsSeenInOneWindowAloneNeverAppears) {
  Tracker tracker = forgetful();
  for (int i = 0; i < 30; ++i) {
    std::vector<Person> people = {scored(1, 0.9f)};
    if (i % 10 == 5) people.push_back(scored(10 + i, 0.99f));
    EXPECT_EQ(tracker.update(at(kStep * i), people), 1u);
  }
  std::vector<Person> people = {scored(1, 0.9f)};
  update_one(tracker, kStep * 30, scored(3, 0.99f));
  for (int i = 31; i < 60; ++i) {
    people = {scored(3, 0.99f)};
    tracker.update(at(kStep * i), people);
  }
  EXPECT_EQ(people[0].id, 2u) << "those who never appeared took no id";
}

TEST(Tracker, WhomAWindowIsLessSureOfStays) {
  Tracker tracker = forgetful();
  for (int i = 0; i < 60; ++i) {
    std::vector<Person> people = {scored(1, i % 2 == 0 ? 0.9f : 0.1f)};
    EXPECT_EQ(tracker.update(at(kStep * i), people), 1u) << i;
    EXPECT_EQ(people[0].id, 1u);
  }
}

TEST(Tracker, TheSurestArePublishedWhereThereArePlacesForFewer) {
  Tracker tracker = forgetful(2);
  std::vector<Person> people = {scored(1, 0.5f), scored(3, 0.9f), scored(5, 0.7f)};
  EXPECT_EQ(tracker.update(at(milliseconds(0)), people), 2u);
  EXPECT_NEAR(people[0].score + people[1].score, 1.6, 1e-6);
  EXPECT_LT(people[0].id, people[1].id);
}

// A place between the tracks of two: it is the surer one who is there.
TEST(Tracker, OfTwoAsNearTheSurerOneGoesOn) {
  Tracker tracker({milliseconds(1000), false, milliseconds(300)});
  std::vector<Person> people;
  for (int i = 0; i < 20; ++i) {
    people = {scored(1.0, 0.4f), scored(1.4, 0.9f)};
    tracker.update(at(kStep * i), people);
  }
  const std::uint32_t surer = people[1].id;
  EXPECT_EQ(update_one(tracker, kStep * 20, scored(1.19, 0.8f)), surer);
}

// Ten new people in every window, for ever: places run out, memory does not.
TEST(Tracker, ACrowdOfStrangersNeedsNoMemory) {
  std::mt19937 random(9);
  std::uniform_real_distribution<double> metres(0, 1000);
  Tracker tracker({milliseconds(10'000), true});
  std::vector<Person> people(kMaxPeople);
  std::uint32_t last_id = 0;
  const std::size_t before = testing::allocations;
  for (int i = 0; i < 500; ++i) {
    for (Person& person : people) person = standing(metres(random), metres(random));
    tracker.update(at(kStep * i), people);
    EXPECT_GT(people[0].id, last_id);
    last_id = people.back().id;
  }
  EXPECT_EQ(testing::allocations, before);
  EXPECT_LE(tracker.tracks(), 32u);
}

}  // namespace
}  // namespace csipose
