#include "model/one_euro.h"

#include <gtest/gtest.h>

namespace csipose {
namespace {

TEST(OneEuro, AConstantPassesUnchanged) {
  OneEuro filter;
  for (int i = 0; i < 10; ++i) EXPECT_EQ(filter.filter(1.25, 0.033), 1.25);
}

TEST(OneEuro, FirstValueAndNoTimePassUnchanged) {
  OneEuro filter;
  EXPECT_EQ(filter.filter(3, 0.033), 3);
  EXPECT_EQ(filter.filter(5, 0), 5);
}

// Without the speed term the answer to a step is 1 - (1 - w)^n, w = 1 / (1 + 1 / (2 pi f dt)).
TEST(OneEuro, StepResponseInClosedForm) {
  const double dt_s = 0.02, cutoff_hz = 1;
  const OneEuroSettings settings = {cutoff_hz, 0, 1};
  const double weight = 1 / (1 + 1 / (2 * std::numbers::pi * cutoff_hz * dt_s));
  OneEuro filter;
  filter.filter(0, dt_s, settings);
  double left = 1;
  for (int n = 1; n < 100; ++n) {
    left *= 1 - weight;
    EXPECT_NEAR(filter.filter(1, dt_s, settings), 1 - left, 1e-12);
  }
}

TEST(OneEuro, FastMotionLagsLessThanSlowMotionInTime) {
  const auto lag_s = [](double speed) {
    OneEuro filter;
    double t = 0, filtered = 0;
    for (; t < 5; t += 0.033) filtered = filter.filter(speed * t, 0.033);
    return (speed * (t - 0.033) - filtered) / speed;
  };
  EXPECT_LT(lag_s(2.0), 0.5 * lag_s(0.1));
  EXPECT_LT(lag_s(2.0), 0.035);
}

}  // namespace
}  // namespace csipose
