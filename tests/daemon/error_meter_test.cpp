#include "daemon/error_meter.h"

#include <gtest/gtest.h>

#include <cmath>

namespace csipose {
namespace {

/// Everybody has this shape, somewhere else.
Skeleton person_at(float x, float y) {
  Skeleton joints;
  for (std::size_t j = 0; j < kJoints; ++j)
    joints[j] = {x + 0.02F * static_cast<float>(j), y, 0.1F * static_cast<float>(j)};
  return joints;
}

TEST(ErrorMeter, MeasuresTheMeanJointErrorOfTheMatched) {
  ErrorMeter meter;
  // Named in the other order, one 30 cm to the right, one 40 cm further in.
  const FrameError error = meter.add(std::vector{person_at(3, 2.4F), person_at(1.3F, 1)},
                                     std::vector{person_at(1, 1), person_at(3, 2)});
  EXPECT_EQ(error.matched, 2U);
  EXPECT_NEAR(error.error_m, 0.7, 1e-5);
  EXPECT_NEAR(meter.poses().mean_error_m(), 0.35, 1e-5);
  EXPECT_EQ(meter.poses().found_ratio(), 1);
  EXPECT_EQ(meter.poses().count_right_ratio(), 1);
}

TEST(ErrorMeter, WhoIsFurtherThanHalfAMetreIsNotFound) {
  ErrorMeter meter;
  const FrameError error = meter.add(std::vector{person_at(1.49F, 1), person_at(3.51F, 2)},
                                     std::vector{person_at(1, 1), person_at(3, 2)});
  EXPECT_EQ(error.matched, 1U);
  EXPECT_NEAR(error.error_m, 0.49, 1e-5);
  EXPECT_EQ(meter.poses().found_ratio(), 0.5);
}

TEST(ErrorMeter, CountsFramesWithTheRightNumberOfPeople) {
  ErrorMeter meter;
  meter.add({}, {});
  meter.add({}, std::vector{person_at(1, 1)});
  meter.add(std::vector{person_at(1, 1), person_at(1, 1)}, std::vector{person_at(1, 1)});
  meter.add(std::vector{person_at(1, 1)}, std::vector{person_at(1, 1)});
  EXPECT_EQ(meter.poses().frames, 4U);
  EXPECT_EQ(meter.poses().count_right_ratio(), 0.5);
  EXPECT_EQ(meter.poses().claimed, 3U);
  EXPECT_EQ(meter.poses().matched, 2U) << "two claims of one person are one hit";
  EXPECT_DOUBLE_EQ(meter.poses().claimed_rightly_ratio(), 2. / 3);
}

TEST(ErrorMeter, NobodyAndNumbersThatAreNoneMatchNobody) {
  ErrorMeter meter;
  EXPECT_TRUE(std::isnan(meter.poses().mean_error_m()));
  EXPECT_TRUE(std::isnan(meter.poses().found_ratio()));
  Skeleton broken = person_at(1, 1);
  broken[3].y = kUnknown;
  EXPECT_EQ(meter.add(std::vector{broken}, std::vector{person_at(1, 1)}).matched, 0U);
  EXPECT_TRUE(std::isnan(meter.poses().mean_error_m()));
}

// Somebody stands at x = 1 and then at x = 1.4: the guess, knowing only what was, is 0.4 off, then 0.2.
TEST(ErrorMeter, TheGuessIsTheMeanOfWhatWasAndNothingOfWhatIs) {
  ErrorMeter meter;
  meter.add({}, std::vector{person_at(1, 1)});
  EXPECT_EQ(meter.guess().frames, 0U) << "nothing is known before the first frame";
  meter.add({}, std::vector{person_at(1.4F, 1)});
  EXPECT_NEAR(meter.guess().mean_error_m(), 0.4, 1e-5);
  meter.add({}, std::vector{person_at(1.4F, 1)});
  EXPECT_NEAR(meter.guess().mean_error_m(), 0.3, 1e-5);
  EXPECT_EQ(meter.guess().count_right_ratio(), 1);
}

TEST(ErrorMeter, TheGuessClaimsTheUsualNumber) {
  ErrorMeter meter;
  const std::vector two{person_at(1, 1), person_at(1.2F, 1)};
  for (int i = 0; i < 3; ++i) meter.add({}, two);
  meter.add({}, std::vector{person_at(1, 1)});
  EXPECT_EQ(meter.guess().frames, 3U);
  EXPECT_EQ(meter.guess().count_right, 2U);
  EXPECT_EQ(meter.guess().matched, 5U);
}

}  // namespace
}  // namespace csipose
