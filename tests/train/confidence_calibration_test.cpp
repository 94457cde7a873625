// People found with known logits, sigmas and errors: the fit must give back what they were made with.
#include "train/confidence_calibration.h"

#include <cmath>

#include "model/config.h"
#include "model/seeded_random.h"

namespace csipose::train {
namespace {

constexpr std::size_t kPeople = 4000;

/// The head says 0.5 / (1 + j) of each joint's true scale; errors fall off exponentially with that scale.
std::vector<Detection> made_up(bool sigma_head) {
  SeededRandom random(2, "found", {});
  std::vector<Detection> found(kPeople);
  for (Detection& detection : found) {
    const double logit = 2 * random.normal();
    detection.logit = static_cast<float>(logit);
    detection.error_m.fill(kUnknown);
    detection.sigma_m.fill(kUnknown);
    const double scale_m = 0.02 + 0.4 * random.uniform();
    const bool there = random.uniform() < 1 / (1 + std::exp(1 - 2 * logit));
    if (there) detection.match = 0;
    for (std::size_t j = 0; j < kJoints; ++j) {
      if (sigma_head) detection.sigma_m[j] = static_cast<float>(scale_m * 0.5 / (1 + static_cast<double>(j)));
      if (there) detection.error_m[j] = static_cast<float>(-scale_m * std::log(1 - random.uniform()));
    }
  }
  return found;
}

TEST(FitConfidences, GivesBackWhatTheDataWereMadeWith) {
  const ConfidenceFit fit = fit_confidences(made_up(true), {}, {});
  EXPECT_EQ(fit.found, kPeople);
  ASSERT_TRUE(fit.calibration.score && fit.calibration.joint_scale && fit.calibration.confidence);
  EXPECT_NEAR(fit.calibration.score->a, 2, 0.2);
  EXPECT_NEAR(fit.calibration.score->b, -1, 0.2);
  for (std::size_t j = 0; j < kJoints; ++j) {
    const double factor = 2 * (1 + static_cast<double>(j));
    EXPECT_NEAR((*fit.calibration.joint_scale)[j] / factor, 1, 0.1) << j;
  }
  // Errors were exponential: with the right scale the curve has next to nothing to correct.
  for (std::size_t i = 0; i < kConfidenceKnots; ++i)
    EXPECT_NEAR(fit.calibration.confidence->corrected[i], fit.calibration.confidence->raw[i], 0.04) << i;
  EXPECT_GT(fit.score.before.expected_error(), 0.1);
  EXPECT_LT(fit.score.after.expected_error(), 0.02);
  EXPECT_GT(fit.joints.before.expected_error(), 0.3);
  EXPECT_LT(fit.joints.after.expected_error(), 0.01);
  EXPECT_EQ(fit.joints.after.count(), kJoints * fit.matched);
}

TEST(FitConfidences, WhatWasFittedNeedsNoSecondFit) {
  const std::vector<Detection> found = made_up(true);
  const ConfidenceFit once = fit_confidences(found, {}, {}),
                      twice = fit_confidences(found, {}, once.calibration);
  EXPECT_EQ(twice.score.before.expected_error(), once.score.after.expected_error());
  EXPECT_EQ(twice.joints.before.expected_error(), once.joints.after.expected_error());
  EXPECT_EQ(twice.calibration.score->a, once.calibration.score->a) << "fitted to what the network said";
}

TEST(FitConfidences, WithoutTheHeadOnlyTheScore) {
  const ConfidenceFit fit = fit_confidences(made_up(false), {}, {});
  EXPECT_TRUE(fit.calibration.score);
  EXPECT_FALSE(fit.calibration.joint_scale || fit.calibration.confidence);
  EXPECT_EQ(fit.joints.before.count(), 0u);
}

// All found were there: only the fainter ones say where the score must fall, and they are not in what is reported.
TEST(FitConfidences, TheFaintHoldTheCurveDown) {
  const auto person = [](float logit, std::size_t match) {
    Detection detection;
    detection.logit = logit;
    detection.match = match;
    detection.error_m.fill(match == kMissed ? kUnknown : 0.1f);
    detection.sigma_m.fill(kUnknown);
    return detection;
  };
  const std::vector<Detection> found(98, person(1, 0)), faint(198, person(-3, kMissed));
  EXPECT_FALSE(fit_confidences(found, {}, {}).calibration.score);
  const ConfidenceFit fit = fit_confidences(found, faint, {});
  ASSERT_TRUE(fit.calibration.score);
  EXPECT_NEAR(person_score(1, fit.calibration), 0.99, 1e-4);
  EXPECT_NEAR(person_score(-3, fit.calibration), 0.005, 1e-4);
  EXPECT_EQ(fit.score.after.count(), 98u);
  EXPECT_NEAR(fit.score.after.expected_error(), 0.01, 1e-4);
}

TEST(FitConfidences, NobodyFoundGivesNothing) {
  const ConfidenceFit fit = fit_confidences({}, {}, {});
  EXPECT_FALSE(fit.calibration.score || fit.calibration.joint_scale || fit.calibration.confidence);
}

// The weights file with a fit is a weights file, and the engine's people carry it.
TEST(FitConfidences, AreReadBackByTheModel) {
  NetworkConfig config = preset_config("micro");
  config.joint_sigma = true;
  const auto file = SafetensorsFile::parse(random_weights(config, 3, HeadInit::random), "draft");
  const Calibration fitted = fit_confidences(made_up(true), {}, {}).calibration;
  const auto model = Model::from(SafetensorsFile::parse(with_confidences(file, fitted, "{}"), "calibrated"));
  for (const float logit : {-3.f, 0.f, 2.f})
    EXPECT_EQ(person_score(logit, model->calibration()), person_score(logit, fitted));
  for (const float sigma_m : {0.01f, 0.1f, 0.7f}) {
    const float expected_m = expected_error_m(sigma_m, 4, fitted);
    EXPECT_EQ(expected_error_m(sigma_m, 4, model->calibration()), expected_m);
    EXPECT_EQ(joint_confidence(expected_m, model->calibration()), joint_confidence(expected_m, fitted));
  }
}

}  // namespace
}  // namespace csipose::train
