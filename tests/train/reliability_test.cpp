// Fits whose answers have closed forms, and statements whose error can be counted.
#include "train/reliability.h"

#include <cmath>

#include "model/seeded_random.h"

namespace csipose::train {
namespace {

double sigmoid(double z) { return 1 / (1 + std::exp(-z)); }

void add(std::vector<Verdict>& verdicts, double said, std::size_t came_true, std::size_t did_not) {
  for (std::size_t i = 0; i < came_true + did_not; ++i) verdicts.push_back({said, i < came_true});
}

TEST(Reliability, CountedByHand) {
  Reliability stated;
  EXPECT_TRUE(std::isnan(stated.expected_error()));
  for (int i = 0; i < 8; ++i) stated.add(0.75, i < 6);  // right
  stated.add(0.05, true);                               // off by 0.95
  stated.add(1.0, false);                               // the last bin holds its upper edge; off by 1
  EXPECT_EQ(stated.count(), 10u);
  EXPECT_NEAR(stated.expected_error(), (0.95 + 1) / 10, 1e-12);
}

TEST(Reliability, ABinIsJudgedByItsMean) {
  Reliability stated;
  stated.add(0.72, true);
  stated.add(0.78, true);
  stated.add(0.74, false);
  stated.add(0.76, true);
  EXPECT_NEAR(stated.expected_error(), 0, 1e-12) << "75 % said on the mean, three of four came true";
}

// With two logits the curve goes through the mean of Platt's targets at both.
TEST(FitPlatt, TwoLogitsHaveAClosedForm) {
  std::vector<Verdict> verdicts;
  add(verdicts, -1, 10, 30);
  add(verdicts, 3, 50, 10);
  const double yes = 61. / 62, no = 1. / 42;
  const double low = (10 * yes + 30 * no) / 40, high = (50 * yes + 10 * no) / 60;
  const auto fit = fit_platt(verdicts);
  ASSERT_TRUE(fit);
  const auto a = static_cast<double>(fit->a), b = static_cast<double>(fit->b);
  EXPECT_NEAR(sigmoid(-a + b), low, 1e-6);
  EXPECT_NEAR(sigmoid(3 * a + b), high, 1e-6);
}

TEST(FitPlatt, FindsWhatTheNumbersWereDrawnFrom) {
  SeededRandom random(1, "platt", {});
  std::vector<Verdict> verdicts;
  for (int i = 0; i < 40000; ++i) {
    const double logit = 5 + 0.5 * random.normal();  // far from zero and narrow
    verdicts.push_back({logit, random.uniform() < sigmoid(4 * logit - 20)});
  }
  const auto fit = fit_platt(verdicts);
  ASSERT_TRUE(fit);
  EXPECT_NEAR(fit->a, 4, 0.15);
  EXPECT_NEAR(fit->b, -20, 0.75);
}

TEST(FitPlatt, SeparableVerdictsMakeNoCertainty) {
  std::vector<Verdict> verdicts;
  add(verdicts, 1, 0, 8);
  add(verdicts, 2, 18, 0);
  const auto fit = fit_platt(verdicts);
  ASSERT_TRUE(fit);
  EXPECT_NEAR(sigmoid(static_cast<double>(fit->a + fit->b)), 0.1, 1e-5);
  EXPECT_NEAR(sigmoid(static_cast<double>(2 * fit->a + fit->b)), 0.95, 1e-5);
}

TEST(FitPlatt, NothingWhereNothingRises) {
  std::vector<Verdict> all_true, one_logit, falling;
  add(all_true, 0.1, 20, 0);
  add(all_true, 1.7, 21, 0);
  add(one_logit, 0.7, 20, 10);
  add(falling, 0, 20, 10);
  add(falling, 1, 10, 20);
  EXPECT_FALSE(fit_platt({}));
  EXPECT_FALSE(fit_platt(all_true));
  EXPECT_FALSE(fit_platt(one_logit));
  EXPECT_FALSE(fit_platt(falling));
}

TEST(PoolAdjacentViolators, KnownAnswers) {
  const auto fit = [](std::vector<double> values, std::vector<double> weights) {
    return pool_adjacent_violators(values, weights);
  };
  EXPECT_EQ(fit({1, 2, 3}, {1, 1, 1}), (std::vector<double>{1, 2, 3}));
  EXPECT_EQ(fit({1, 3, 2, 4}, {1, 1, 1, 1}), (std::vector<double>{1, 2.5, 2.5, 4}));
  EXPECT_EQ(fit({1, 3, 2, 4}, {1, 1, 3, 1}), (std::vector<double>{1, 2.25, 2.25, 4}));
  EXPECT_EQ(fit({3, 2, 1}, {1, 1, 1}), (std::vector<double>{2, 2, 2}));
  EXPECT_EQ(fit({2, 4, 4, 0}, {1, 1, 1, 2}), (std::vector<double>{2, 2, 2, 2}))
      << "a pool pools with its left";
  EXPECT_TRUE(fit({}, {}).empty());
}

TEST(FitCurve, EvenGroupsGiveTheirMeans) {
  std::vector<Verdict> verdicts;  // twenty groups of ten; in group g, g / 2 came true
  for (std::size_t g = 0; g < kConfidenceKnots; ++g)
    for (std::size_t i = 0; i < 10; ++i)
      verdicts.push_back({static_cast<double>(10 * g + i) / 200, i < g / 2});
  std::reverse(verdicts.begin(), verdicts.end());
  const ConfidenceCurve curve = fit_curve(verdicts);
  for (std::size_t g = 0; g < kConfidenceKnots; ++g) {
    EXPECT_NEAR(curve.raw[g], (10 * static_cast<double>(g) + 4.5) / 200, 1e-6);
    EXPECT_NEAR(curve.corrected[g], static_cast<double>(g / 2) / 10, 1e-6);
  }
}

TEST(FitCurve, FewNumbersLeaveKnotsAboveAll) {
  std::vector<Verdict> verdicts;
  add(verdicts, 0.9, 30, 10);
  add(verdicts, 0.5, 5, 5);
  const ConfidenceCurve curve = fit_curve(verdicts);
  EXPECT_EQ(curve.raw[0], 0.5f);
  EXPECT_EQ(curve.raw[1], 0.9f);
  EXPECT_EQ(curve.corrected[0], 0.5f);
  for (std::size_t i = 1; i < kConfidenceKnots; ++i) {
    EXPECT_EQ(curve.corrected[i], 0.75f);
    EXPECT_GT(curve.raw[i], curve.raw[i - 1]);
  }
  EXPECT_EQ(fit_curve({{0.3, true}}).corrected, fit_curve({{1.0, true}}).corrected);
}

}  // namespace
}  // namespace csipose::train
