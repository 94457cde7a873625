#include "model/pose_estimator.h"

#include <gtest/gtest.h>

#include <cmath>

#include "model/model.h"
#include "proto/result.h"
#include "tests/counting_allocator.h"
#include "tests/model/made_up_background.h"

namespace csipose {
namespace {

/// Stands in for a network: answers what the test wrote.
class Scripted final : public Engine {
 public:
  std::span<const float> stage(const std::string&) const override { return {}; }
  Precision precision() const override { return Precision::f32; }
  std::string describe() const override { return "scripted"; }
  void answer(const std::vector<float>& x_of_people_m) {
    logits.assign(x_of_people_m.size(), 4.f);
    poses.clear();
    for (const float x_m : x_of_people_m)
      for (std::size_t j = 0; j < kJoints; ++j)
        poses.insert(poses.end(), {x_m, 1, 0.1f * static_cast<float>(j)});
  }
  std::vector<float> logits, poses;
  LinkSet last_links;
  const Background* last_background = nullptr;
  int runs = 0;

 private:
  NetworkOutput infer(std::span<const float>, LinkSet links, const Background* background) override {
    ++runs;
    last_links = links;
    last_background = background;
    return {logits, poses, {}};
  }
};

class Estimator : public ::testing::Test {
 protected:
  Estimator() {
    window.links.set();
    window.last_sample = SteadyTime{std::chrono::seconds(1)};
    auto engine = std::make_unique<Scripted>();
    network = engine.get();
    network->answer({1, 3});
    estimator = std::make_unique<PoseEstimator>(model, std::move(engine), EstimatorConfig{});
  }
  const Estimate& next() {
    window.last_sample += std::chrono::milliseconds(33);
    return estimator->estimate(window);
  }
  std::shared_ptr<const Model> model = init_random(preset_config("micro"), 1, HeadInit::zero);  // min_links 3
  Scripted* network = nullptr;
  std::unique_ptr<PoseEstimator> estimator;
  Window window;
};

TEST_F(Estimator, GivesTrackedPeople) {
  const Estimate& estimate = next();
  ASSERT_EQ(estimate.people_count, 2u);
  EXPECT_EQ(estimate.reasons, 0u);
  EXPECT_EQ(estimate.people[0].id, 1u);
  EXPECT_EQ(estimate.people[1].id, 2u);
  network->answer({3.05f, 1.02f});
  next();
  EXPECT_EQ(estimate.people[0].id, 1u);
  EXPECT_NEAR(estimate.people[0].joints[0].x, 1.02f, 1e-6);
  EXPECT_EQ(estimate.people[0].age_ms, 33u);
}

TEST_F(Estimator, WhoIsNotSeenIsNotSent) {
  next();
  network->answer({1});
  EXPECT_EQ(next().people_count, 1u);
  network->answer({});
  EXPECT_EQ(next().people_count, 0u);
}

TEST_F(Estimator, TooFewLinksGiveNobodyAndTheNetworkDoesNotRun) {
  window.links = LinkSet(0b11);
  const Estimate& estimate = next();
  EXPECT_EQ(estimate.people_count, 0u);
  EXPECT_EQ(estimate.reasons, reason_bit(Reason::too_few_links));
  EXPECT_EQ(network->runs, 0);
  window.links = LinkSet(0b111);
  EXPECT_EQ(next().people_count, 2u);
  EXPECT_EQ(network->last_links, LinkSet(0b111));
}

TEST_F(Estimator, NanInAPresentLinkGivesNobodyInAnAbsentOneIsNotLookedAt) {
  window.x[Window::index(35, 7, 4)] = NAN;
  EXPECT_EQ(next().reasons, reason_bit(Reason::nan_input));
  EXPECT_EQ(network->runs, 0);
  window.links.reset(4);
  EXPECT_EQ(next().people_count, 2u);
}

// Weights that know two installations: one of them, then a third, then the first again.
TEST(EstimatorOfInstallations, NobodyIsInferredWhereTheWeightsKnowNothing) {
  const Background den = testing::made_up_background("den", 1), hall = testing::made_up_background("hall", 2),
                   elsewhere = testing::made_up_background("", 3);
  const auto model =
      testing::with_backgrounds(random_weights(preset_config("micro"), 5, HeadInit::zero), {den, hall});
  auto scripted = std::make_unique<Scripted>();
  scripted->answer({1});
  const Scripted* engine_of_rooms = scripted.get();
  PoseEstimator estimator(model, std::move(scripted), EstimatorConfig{});
  Window window;
  window.links.set();
  std::uint64_t seed = 0;
  const auto estimate = [&](const Background& background) -> const Estimate& {
    std::ranges::copy(testing::window_before(background, ++seed), window.x.begin());
    window.last_sample += std::chrono::milliseconds(100);
    return estimator.estimate(window);
  };
  for (int i = 0; i < 50; ++i) ASSERT_EQ(estimate(hall).people_count, 1u);
  EXPECT_EQ(estimate(elsewhere).people_count, 1u) << "one window proves nothing";
  int windows = 1;
  while (estimate(elsewhere).people_count > 0 && windows < 1000) ++windows;
  EXPECT_LT(windows, 50) << "five seconds do";
  EXPECT_EQ(estimate(elsewhere).reasons, reason_bit(Reason::unknown_installation));
  for (int i = 0; i < 1000; ++i) estimate(den);
  EXPECT_EQ(estimate(den).people_count, 1u);
  EXPECT_EQ(estimate(den).reasons, 0u);
  ASSERT_NE(engine_of_rooms->last_background, nullptr);
  EXPECT_EQ(engine_of_rooms->last_background->name, "den");
  estimate(hall);
  EXPECT_EQ(engine_of_rooms->last_background->name, "den") << "one window proves nothing";
  estimator.reset();
  EXPECT_EQ(estimate(elsewhere).reasons, reason_bit(Reason::unknown_installation)) << "nothing is remembered";
}

TEST_F(Estimator, AnAnswerThatIsNotFiniteGivesNobody) {
  network->poses[3] = NAN;
  EXPECT_EQ(next().people_count, 0u);
  EXPECT_EQ(next().reasons, reason_bit(Reason::nan_input));
}

TEST_F(Estimator, WithoutTrackingIdsAreZero) {
  EstimatorConfig config;
  config.track = false;
  estimator->configure(config);
  EXPECT_EQ(next().people[1].id, 0u);
}

TEST_F(Estimator, ResetFollowsNobodyAcrossTheSilence) {
  next();
  estimator->reset();
  EXPECT_EQ(next().people[0].id, 3u);
}

TEST_F(Estimator, RefusesSettingsThatMakeNoSense) {
  EstimatorConfig config;
  config.max_people = 11;
  EXPECT_THROW(estimator->configure(config), SetupError);
  config.max_people = 0;
  EXPECT_THROW(estimator->configure(config), SetupError);
  config = {};
  config.min_score = NAN;
  EXPECT_THROW(estimator->configure(config), SetupError);
  config = {};
  config.track = false;
  config.smoothing = Smoothing::one_euro;
  EXPECT_THROW(estimator->configure(config), SetupError);
  EXPECT_EQ(next().people_count, 2u);  // the old settings still hold
}

TEST_F(Estimator, DoesNotAllocate) {
  EstimatorConfig config;
  config.smoothing = Smoothing::one_euro;
  estimator->configure(config);
  next();
  const std::size_t before = testing::allocations;
  for (int i = 0; i < 100; ++i) next();
  EXPECT_EQ(testing::allocations, before);
}

TEST(EstimatorWithANetwork, AnUntrainedNetworkFindsNobody) {
  const auto model = init_random(preset_config("micro"), 1, HeadInit::zero);
  PoseEstimator estimator(model, make_reference_engine(model), {});
  Window window;
  window.links.set();
  const Estimate& estimate = estimator.estimate(window);
  EXPECT_EQ(estimate.people_count, 0u);
  EXPECT_EQ(estimate.reasons, 0u);
  EXPECT_TRUE(estimator.model().untrained());
}

TEST(EstimatorWithANetwork, UntrainedNetworksFindNobodyInNoise) {
  for (std::uint64_t seed = 1; seed <= 5; ++seed) {
    const auto model = init_random(preset_config("tiny"), seed, HeadInit::zero);
    PoseEstimator estimator(model, make_reference_engine(model), {});
    Window window;
    window.links.set();
    SeededRandom random(seed, "window");
    for (float& number : window.x) number = static_cast<float>(random.normal());
    const Estimate& estimate = estimator.estimate(window);
    EXPECT_EQ(estimate.people_count, 0u) << seed;
    EXPECT_EQ(estimate.reasons, 0u);
    EXPECT_TRUE(estimator.model().untrained());
  }
}

/// Probability p as a logit.
float logit_of(float p) { return std::log(p / (1 - p)); }

TEST_F(Estimator, AScoreIsTheWindowsOwnWithoutTrackingOrMemory) {
  for (const bool track : {true, false}) {
    EstimatorConfig config;
    config.track = track;
    config.score_memory = {};
    estimator->configure(config);
    estimator->reset();
    for (const float score : {0.9f, 0.3f, 0.4f}) {
      for (float& logit : network->logits) logit = logit_of(score);
      const Estimate& estimate = next();
      ASSERT_EQ(estimate.people_count, score < config.min_score ? 0u : 2u);
      if (score >= config.min_score) {
        EXPECT_NEAR(estimate.people[0].score, score, 1e-6);
      }
    }
  }
}

TEST_F(Estimator, SomebodyOfWhomAWindowIsLessSureIsStillSent) {
  next();
  for (float& logit : network->logits) logit = logit_of(0.2f);
  EXPECT_EQ(next().people_count, 2u);
  for (float& logit : network->logits) logit = logit_of(0.05f);
  EXPECT_EQ(next().people_count, 0u) << "nobody is followed on that";
}

}  // namespace
}  // namespace csipose
