#include "model/normalisation.h"

#include <gtest/gtest.h>

#include <cmath>
#include <complex>
#include <numbers>

#include "model/engine.h"
#include "proto/result.h"
#include "tests/model/made_up_background.h"

namespace csipose {
namespace {

using testing::made_up_background;
using testing::window_before;

const LinkSet kAll = LinkSet().set();

TEST(Wrapped, TakesWholeTurnsOff) {
  for (double phase = -9; phase < 9; phase += 0.01)
    EXPECT_NEAR(wrapped(static_cast<float>(phase)), std::remainder(phase, 2 * std::numbers::pi), 1e-5)
        << phase;
}

TEST(Normalisation, ScalarsGiveMeanAndDeviation) {
  std::vector<float> x(kChannels * kTokens), tokens(x.size());
  for (std::size_t i = 0; i < x.size(); ++i) x[i] = static_cast<float>(i % 101);
  write_tokens({3, 2, 4, {}}, nullptr, x, kAll, tokens);
  for (std::size_t c = 0; c < kChannels; ++c)
    for (std::size_t t = 0; t < kSamples; ++t)
      for (std::size_t l = 0; l < kLinks; ++l) {
        const float value = x[Window::index(c, t, l)];
        ASSERT_FLOAT_EQ(tokens[(t * kLinks + l) * kChannels + c], c < 30 ? (value - 3) / 2 : value / 4);
      }
}

// (x - mean) / deviation, by the exponential of i (phase - mean) where it is a phase.
TEST(Normalisation, ABackgroundIsTakenOffOnTheCircle) {
  const Background background = made_up_background("hall", 3);
  const std::vector<float> x = window_before(background, 4);
  std::vector<float> tokens(x.size());
  write_tokens({}, &background, x, kAll, tokens);
  std::size_t across = 0;
  for (std::size_t c = 0; c < kChannels; ++c)
    for (std::size_t t = 0; t < kSamples; ++t)
      for (std::size_t l = 0; l < kLinks; ++l) {
        const auto mean = static_cast<double>(background.mean[c * kLinks + l]);
        double difference = static_cast<double>(x[Window::index(c, t, l)]) - mean;
        across += c >= 30 && std::fabs(difference) > std::numbers::pi;
        if (c >= 30) difference = std::arg(std::polar(1., difference));
        ASSERT_NEAR(static_cast<double>(tokens[(t * kLinks + l) * kChannels + c]),
                    difference / static_cast<double>(background.deviation[c * kLinks + l]), 1e-4);
      }
  EXPECT_GT(across, 100u) << "phases on both sides of the cut";
}

TEST(Normalisation, LinksThatAreNotThereAreLeftOut) {
  const Background background = made_up_background("hall", 3);
  const std::vector<float> x = window_before(background, 4);
  std::vector<float> all(x.size()), some(kSamples * 2 * kChannels);
  write_tokens({}, &background, x, kAll, all);
  write_tokens({}, &background, x, LinkSet().set(1).set(7), some);
  for (std::size_t t = 0; t < kSamples; ++t)
    for (std::size_t i = 0; i < 2; ++i)
      for (std::size_t c = 0; c < kChannels; ++c)
        ASSERT_EQ(some[(2 * t + i) * kChannels + c], all[(9 * t + (i == 0 ? 1 : 7)) * kChannels + c]);
}

TEST(NearestBackground, IsThatOfTheWindow) {
  std::vector<Background> backgrounds;
  for (std::uint64_t seed = 1; seed <= 4; ++seed) backgrounds.push_back(made_up_background("", seed));
  for (std::uint64_t seed = 0; seed < 40; ++seed) {
    const Background& own = backgrounds[seed % 4];
    const NearestBackground nearest = nearest_background(backgrounds, window_before(own, seed), kAll);
    EXPECT_EQ(nearest.background, &own);
    EXPECT_NEAR(nearest.unlikeness, 1, 0.3);  // mean of 540 squares of normal numbers
  }
  EXPECT_EQ(nearest_background({}, window_before(backgrounds[0], 1), kAll).background, nullptr);
}

// Where one is twice as wide as the other, the wide one explains everything; what decides is how likely it makes it.
TEST(NearestBackground, WeighsHowWideItIs) {
  Background narrow = made_up_background("", 1), wide = narrow;
  for (float& deviation : wide.deviation) deviation *= 2;
  const std::vector<Background> both = {wide, narrow};
  EXPECT_EQ(nearest_background(both, window_before(narrow, 5), kAll).background, &both[1]);
  EXPECT_EQ(nearest_background(both, window_before(wide, 5), kAll).background, &both[0]);
}

TEST(NearestBackground, LooksAtPresentLinksOnly) {
  const std::vector<Background> backgrounds = {made_up_background("", 1), made_up_background("", 2)};
  std::vector<float> x = window_before(backgrounds[1], 5);
  const LinkSet present = LinkSet().set(3).set(4);
  for (std::size_t i = 0; i < x.size(); ++i)
    if (!present[i % kLinks]) x[i] = 0;
  const NearestBackground nearest = nearest_background(backgrounds, x, present);
  EXPECT_EQ(nearest.background, &backgrounds[1]);
  EXPECT_NEAR(nearest.unlikeness, 1, 0.5);
}

TEST(NearestBackground, TellsAStrangeWindow) {
  const std::vector<Background> backgrounds = {made_up_background("", 1), made_up_background("", 2)};
  EXPECT_GT(nearest_background(backgrounds, window_before(made_up_background("", 9), 5), kAll).unlikeness,
            10);
}

TEST(Model, ReadsBackgrounds) {
  const std::vector<Background> written = {made_up_background("den", 1), made_up_background("hall", 2)};
  const auto model =
      testing::with_backgrounds(random_weights(preset_config("micro"), 5, HeadInit::random), written);
  const auto& read = model->normalisation().backgrounds;
  ASSERT_EQ(read.size(), 2u);
  for (std::size_t i = 0; i < 2; ++i) {
    EXPECT_EQ(read[i].name, written[i].name);
    EXPECT_EQ(read[i].mean, written[i].mean);
    EXPECT_EQ(read[i].deviation, written[i].deviation);
  }
}

TEST(Model, RefusesADeviationOfNothing) {
  Background flat = made_up_background("den", 1);
  flat.deviation[77] = 0;
  EXPECT_THROW(testing::with_backgrounds(random_weights(preset_config("micro"), 5, HeadInit::random), {flat}),
               SetupError);
}

// The same weights, once by scalars and once against a background that says the same of every element.
TEST(Engines, ScaleByTheBackground) {
  const auto bytes = random_weights(preset_config("micro"), 5, HeadInit::random);
  Background same{"flat", {}, {}};
  for (std::size_t e = 0; e < kElements; ++e) {
    same.mean[e] = e < kElements / 2 ? 20 : 0.5f;
    same.deviation[e] = e < kElements / 2 ? 5 : 0.25f;
  }
  const auto plain = Model::from(SafetensorsFile::parse(bytes, "plain"));
  const auto model = testing::with_backgrounds(bytes, {made_up_background("other", 1), same});
  std::vector<float> z(kChannels * kTokens), x;
  for (std::size_t i = 0; i < z.size(); ++i) z[i] = std::sin(0.37f * static_cast<float>(i));
  x = z;
  for (std::size_t i = 0; i < x.size(); ++i) x[i] = i < x.size() / 2 ? 20 + 5 * z[i] : 0.5f + 0.25f * z[i];
  const auto a = make_reference_engine(plain), b = make_reference_engine(model);
  for (const LinkSet links : {kAll, LinkSet(0b111000111)}) {
    const NetworkOutput expected = a->run(z, links), got = b->run(x, links);
    for (std::size_t i = 0; i < expected.poses.size(); ++i)
      ASSERT_NEAR(got.poses[i], expected.poses[i], 1e-4) << i;
  }
}

}  // namespace
}  // namespace csipose
