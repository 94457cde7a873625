#include "model/normalisation.h"

#include <gtest/gtest.h>

#include <array>
#include <cmath>
#include <complex>

#include "model/background_meter.h"
#include "model/engine.h"
#include "model/seeded_random.h"
#include "proto/result.h"
#include "tests/model/made_up_background.h"

namespace csipose {
namespace {

using testing::made_up_background;
using testing::window_before;

const LinkSet kAllLinks = LinkSet().set();
const NetworkConfig kPlain = preset_config("micro");

TEST(Normalisation, ScalarsGiveMeanAndDeviation) {
  std::vector<float> x(kChannels * kTokens), tokens(x.size());
  for (std::size_t i = 0; i < x.size(); ++i) x[i] = static_cast<float>(i % 101);
  write_tokens(kPlain, {3, 2, 4, {}}, nullptr, x, kAllLinks, tokens);
  for (std::size_t c = 0; c < kChannels; ++c)
    for (std::size_t t = 0; t < kSamples; ++t)
      for (std::size_t l = 0; l < kLinks; ++l) {
        const float value = x[Window::index(c, t, l)];
        ASSERT_FLOAT_EQ(tokens[(t * kLinks + l) * kChannels + c], c < 30 ? (value - 3) / 2 : value / 4);
      }
}

using Sample = std::array<float, kElements>;

/// The background with a departure drawn for each element, `size` times what it may be, behind a line of each receiver.
Sample sample_before(const Background& background, double size,
                     const std::array<testing::PacketLine, kReceivers>& lines) {
  SeededRandom random(11, "sample", {});
  Sample sample;
  for (std::size_t n = 0; n < kSubcarriers; ++n)
    for (std::size_t l = 0; l < kLinks; ++l) {
      const std::size_t e = n * kLinks + l;
      const std::complex<double> departure = size * std::complex<double>(random.normal(), random.normal());
      testing::write_response(background, n, l, departure, lines[l / kAntennas], sample[e],
                              sample[kFirstPhase + e]);
    }
  return sample;
}

/// The definition, with the slope looked for in steps of 20 microradians and sums in double.
Sample slow_departures(const Background& background, const Sample& sample, LinkSet links) {
  using Complex = std::complex<double>;
  const auto at = [](const Sample& from, std::size_t e) {
    return std::polar(static_cast<double>(from[e]), static_cast<double>(from[kFirstPhase + e]));
  };
  Sample out{};
  for (std::size_t receiver = 0; receiver < kReceivers; ++receiver) {
    const auto over_links = [&](const auto& visit) {
      for (std::size_t e = 0; e < kFirstPhase; ++e)
        if (links[e % kLinks] && e % kLinks / kAntennas == receiver)
          visit(e, static_cast<double>(e / kLinks) - 14.5);
    };
    std::array<Complex, kSubcarriers> products{};
    double power = 0;
    over_links([&](std::size_t e, double) {
      products[e / kLinks] += at(sample, e) * std::conj(at(background.response, e));
      power += std::norm(at(sample, e));
    });
    Complex best = 0;
    double best_slope = 0;
    for (double slope = -0.47; slope < 0.47; slope += 2e-5) {
      Complex sum = 0;
      for (std::size_t n = 0; n < kSubcarriers; ++n)
        sum += products[n] * std::polar(1., -slope * (static_cast<double>(n) - 14.5));
      if (std::abs(sum) > std::abs(best)) best = sum, best_slope = slope;
    }
    over_links([&](std::size_t e, double n) {
      const Complex left = at(sample, e) *
                               std::polar(std::abs(best) / power, -std::arg(best) - best_slope * n) *
                               std::polar(1., -static_cast<double>(background.response[kFirstPhase + e])) -
                           static_cast<double>(background.response[e]);
      out[e] = static_cast<float>(left.real());
      out[kFirstPhase + e] = static_cast<float>(left.imag());
    });
  }
  return out;
}

TEST(Departures, AreThoseOfTheDefinition) {
  const Background background = made_up_background("hall", 3);
  for (const double size : {0.5, 3., 15.}) {  // beside amplitudes from 10 to 30
    const Sample sample =
        sample_before(background, size, {{{1.1, 0.12, 0.9}, {-2.9, -0.31, 1.2}, {0.4, 0.02, 1}}});
    for (const LinkSet links : {kAllLinks, LinkSet(0b110111001)}) {
      const Sample expected = slow_departures(background, sample, links),
                   got = departures(background, sample, links);
      for (std::size_t e = 0; e < kElements; ++e) ASSERT_NEAR(got[e], expected[e], 5e-3) << size << ' ' << e;
    }
  }
}

TEST(Departures, AreNothingWhereNobodyIs) {
  const Background background = made_up_background("hall", 3);
  const Sample sample = sample_before(background, 0, {{{3, 0.4, 0.5}, {-1, -0.4, 2}, {}}});
  for (const float departure : departures(background, sample, kAllLinks)) EXPECT_NEAR(departure, 0, 2e-3);
  const Sample silent{};
  for (const float departure : departures(background, silent, kAllLinks))
    EXPECT_TRUE(std::isfinite(departure));
}

// A packet's detection delay, its carrier's phase and its power, and a cleaning that went a whole turn astray, say nothing of people.
TEST(Departures, DoNotChangeWithThePacket) {
  const Background background = made_up_background("hall", 3);
  const Sample plain = sample_before(background, 3, {}),
               other =
                   sample_before(background, 3, {{{2.1, -0.25, 1.1}, {1.3, 0.21, 0.7}, {-3, 0.105, 1.3}}});
  const Sample a = departures(background, plain, kAllLinks), b = departures(background, other, kAllLinks);
  for (std::size_t e = 0; e < kElements; ++e) ASSERT_NEAR(a[e], b[e], 2e-3) << e;
}

// What the branches do to phases, and a receiver to its amplitudes, the same to people and to the static paths, falls out against
// a background that they did it to as well.
TEST(Departures, DoNotChangeWithTheBranches) {
  const Background one = made_up_background("hall", 3);
  Background other = one;
  Sample sample = sample_before(one, 3, {});
  const Sample before = departures(one, sample, kAllLinks);
  for (std::size_t e = 0; e < kFirstPhase; ++e)
    for (Sample* numbers : {&sample, &other.response}) {
      (*numbers)[e] *= 1.4f;
      (*numbers)[kFirstPhase + e] += static_cast<float>(e % kLinks);
    }
  const Sample after = departures(other, sample, kAllLinks);
  for (std::size_t e = 0; e < kElements; ++e) ASSERT_NEAR(after[e] / 1.4f, before[e], 2e-3) << e;
}

TEST(Normalisation, ABackgroundIsTakenOffByItsDeviations) {
  const Background background = made_up_background("hall", 3);
  const std::vector<float> x = window_before(background, 4);
  std::vector<float> tokens(x.size());
  write_tokens(kPlain, {}, &background, x, kAllLinks, tokens);
  for (std::size_t t = 0; t < kSamples; ++t) {
    Sample sample;
    for (std::size_t e = 0; e < kElements; ++e) sample[e] = x[Window::index(e / kLinks, t, e % kLinks)];
    const Sample departed = departures(background, sample, kAllLinks);
    for (std::size_t e = 0; e < kElements; ++e)
      ASSERT_FLOAT_EQ(tokens[(t * kLinks + e % kLinks) * kChannels + e / kLinks],
                      departed[e] / background.deviation[e]);
  }
}

// Of an element: |B| = 12, deviation 4: a quarter. Gains and phases of a branch fall out of it.
TEST(Mobility, IsTheShareThatPeopleMove) {
  Background background = made_up_background("hall", 3);
  background.response[31] = 12;
  background.deviation[31] = 4;
  background.deviation[kFirstPhase + 31] = 36;
  const Sample before = mobility(background);
  EXPECT_FLOAT_EQ(before[31], 0.25f);
  EXPECT_FLOAT_EQ(before[kFirstPhase + 31], 0.75f);
  for (std::size_t e = 0; e < kElements; ++e) {
    background.deviation[e] *= 2.5f;
    if (e < kFirstPhase)
      background.response[e] *= 2.5f;
    else
      background.response[e] += 1;
  }
  const Sample after = mobility(background);
  for (std::size_t e = 0; e < kElements; ++e) ASSERT_NEAR(after[e], before[e], 1e-6) << e;
}

TEST(Normalisation, TokensMayTellTheMobilityOfTheirLink) {
  const Background background = made_up_background("hall", 3);
  const std::vector<float> x = window_before(background, 4);
  const LinkSet links = LinkSet().set(1).set(7);
  const std::size_t rows = kSamples * links.count();
  std::vector<float> plain(rows * kChannels), told(2 * plain.size()), untold(told.size());
  write_tokens(kPlain, {}, &background, x, links, plain);
  NetworkConfig telling = kPlain;
  telling.background_conditioning = true;
  write_tokens(telling, {}, &background, x, links, told);
  write_tokens(telling, {3, 2, 4, {}}, nullptr, x, links, untold);
  const Sample moves = mobility(background);
  for (std::size_t row = 0; row < rows; ++row)
    for (std::size_t c = 0; c < kChannels; ++c) {
      ASSERT_EQ(told[row * 2 * kChannels + c], plain[row * kChannels + c]);
      ASSERT_EQ(told[(row * 2 + 1) * kChannels + c], moves[c * kLinks + (row % 2 == 0 ? 1 : 7)]);
      ASSERT_EQ(untold[(row * 2 + 1) * kChannels + c], 0);
    }
}

// With all links a receiver's token is the tokens of its links, one after the other; with fewer, 0 where one is not there.
TEST(Normalisation, AReceiversTokenHasItsLinksSideBySide) {
  const Background background = made_up_background("hall", 3);
  const std::vector<float> x = window_before(background, 4);
  for (const bool told : {false, true}) {
    NetworkConfig of_links = kPlain;
    of_links.background_conditioning = told;
    NetworkConfig of_receivers = of_links;
    of_receivers.receiver_tokens = true;
    std::vector<float> links(kTokens * of_links.token_numbers()), receivers(links.size());
    write_tokens(of_links, {}, &background, x, kAllLinks, links);
    write_tokens(of_receivers, {}, &background, x, kAllLinks, receivers);
    EXPECT_EQ(receivers, links);

    const LinkSet some = LinkSet().set(1).set(6).set(8);  // of receivers 0 and 2
    const std::size_t numbers = of_links.link_numbers();
    std::vector<float> there(kSamples * 3 * numbers), gapped(kSamples * 2 * kAntennas * numbers, 1.f);
    write_tokens(of_links, {}, &background, x, some, there);
    write_tokens(of_receivers, {}, &background, x, some, gapped);
    constexpr std::array<int, 6> kFrom = {-1, 0, -1, 1, -1, 2};
    for (std::size_t i = 0; i < gapped.size(); ++i) {
      const std::size_t row = i / numbers / kFrom.size();
      const int from = kFrom[i / numbers % kFrom.size()];
      const float expected =
          from < 0 ? 0.f : there[(row * 3 + static_cast<std::size_t>(from)) * numbers + i % numbers];
      ASSERT_EQ(gapped[i], expected) << i;
    }
  }
}

// Behind a link's own numbers those of the two that follow it around its receiver, 0 where one is not there.
TEST(Normalisation, ALinksTokenMayHaveItsReceiversOthers) {
  const Background background = made_up_background("hall", 3);
  const std::vector<float> x = window_before(background, 4);
  for (const bool told : {false, true}) {
    NetworkConfig alone = kPlain;
    alone.background_conditioning = told;
    NetworkConfig together = alone;
    together.receiver_conditioning = true;
    const std::size_t numbers = alone.link_numbers();
    for (const LinkSet links : {kAllLinks, LinkSet().set(1).set(6).set(8)}) {
      std::vector<float> own(alone.token_count(links) * numbers);
      write_tokens(alone, {}, &background, x, links, own);
      std::vector<float> tokens(together.token_count(links) * together.token_numbers(), 1.f);
      ASSERT_EQ(tokens.size(), 3 * own.size());
      write_tokens(together, {}, &background, x, links, tokens);
      const float* number = tokens.data();
      for (std::size_t t = 0; t < kSamples; ++t)
        for (std::size_t link = 0; link < kLinks; ++link)
          for (std::size_t i = 0; links[link] && i < kAntennas; ++i) {
            const std::size_t other = link - link % kAntennas + (link + i) % kAntennas;
            const std::size_t row = t * links.count() + (links & LinkSet((1u << other) - 1)).count();
            for (std::size_t c = 0; c < numbers; ++c)
              ASSERT_EQ(*number++, links[other] ? own[row * numbers + c] : 0.f) << link << ' ' << i;
          }
    }
  }
}

TEST(Normalisation, SamplesThatAreRepeatedGiveTheSameTokens) {
  const Background background = made_up_background("hall", 3);
  std::vector<float> x = window_before(background, 4), tokens(x.size()), others(x.size());
  write_tokens(kPlain, {}, &background, x, kAllLinks, others);
  for (std::size_t c = 0; c < kChannels; ++c)
    std::copy_n(&x[Window::index(c, 6, 0)], kLinks, &x[Window::index(c, 7, 0)]);
  write_tokens(kPlain, {}, &background, x, kAllLinks, tokens);
  for (std::size_t t = 0; t < kSamples; ++t)
    for (std::size_t i = 0; i < kLinks * kChannels; ++i)
      ASSERT_EQ(tokens[t * kLinks * kChannels + i], others[(t == 7 ? 6 : t) * kLinks * kChannels + i]);
}

TEST(Normalisation, LinksThatAreNotThereAreLeftOut) {
  const Background background = made_up_background("hall", 3);
  const std::vector<float> x = window_before(background, 4);
  std::vector<float> all(x.size()), some(kSamples * 2 * kChannels);
  write_tokens(kPlain, {}, &background, x, kAllLinks, all);
  write_tokens(kPlain, {}, &background, x, LinkSet().set(1).set(7), some);
  std::vector<float> scaled_all(x.size()), scaled(some.size());
  write_tokens(kPlain, {3, 2, 4, {}}, nullptr, x, kAllLinks, scaled_all);
  write_tokens(kPlain, {3, 2, 4, {}}, nullptr, x, LinkSet().set(1).set(7), scaled);
  for (std::size_t t = 0; t < kSamples; ++t)
    for (std::size_t i = 0; i < 2; ++i)
      for (std::size_t c = 0; c < kChannels; ++c) {
        const std::size_t here = (2 * t + i) * kChannels + c,
                          there = (9 * t + (i == 0 ? 1 : 7)) * kChannels + c;
        ASSERT_EQ(scaled[here], scaled_all[there]);
        ASSERT_NEAR(some[here], all[there], 4) << "brought over the background by fewer links";
      }
}

TEST(NearestBackground, IsThatOfTheWindow) {
  std::vector<Background> backgrounds;
  for (std::uint64_t seed = 1; seed <= 4; ++seed) backgrounds.push_back(made_up_background("", seed));
  for (std::uint64_t seed = 0; seed < 40; ++seed) {
    const Background& own = backgrounds[seed % 4];
    const NearestBackground nearest = nearest_background(backgrounds, window_before(own, seed), kAllLinks);
    EXPECT_EQ(nearest.background, &own);
    EXPECT_NEAR(nearest.unlikeness, 1, 0.3);  // mean of 540 squares of normal numbers, twelve of them fitted
  }
  EXPECT_EQ(nearest_background({}, window_before(backgrounds[0], 1), kAllLinks).background, nullptr);
}

// Where one is twice as wide as the other, the wide one explains everything; what decides is how likely it makes it.
TEST(NearestBackground, WeighsHowWideItIs) {
  Background narrow = made_up_background("", 1), wide = narrow;
  for (float& deviation : wide.deviation) deviation *= 2;
  const std::vector<Background> both = {wide, narrow};
  EXPECT_EQ(nearest_background(both, window_before(narrow, 5), kAllLinks).background, &both[1]);
  EXPECT_EQ(nearest_background(both, window_before(wide, 5), kAllLinks).background, &both[0]);
}

// Somebody who stands in one link's way: what he does there is far from usual, what the others show decides.
TEST(NearestBackground, IsNotMisledByOneLink) {
  const Background own = made_up_background("", 1);
  Background other = made_up_background("", 2);
  for (float& deviation : other.deviation) deviation *= 8;  // people are strong there: nothing surprises it
  std::vector<float> x = window_before(own, 5);
  for (std::size_t n = 0; n < kSubcarriers; ++n)
    for (std::size_t t = 0; t < kSamples; ++t) x[Window::index(n, t, 4)] *= 6;
  const std::vector<Background> both = {other, own};
  EXPECT_EQ(nearest_background(both, x, kAllLinks).background, &both[1]);
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
  EXPECT_GT(
      nearest_background(backgrounds, window_before(made_up_background("", 9), 5), kAllLinks).unlikeness, 10);
}

std::vector<std::vector<float>> windows_before(const Background& background, std::uint64_t count) {
  std::vector<std::vector<float>> windows;
  for (std::uint64_t seed = 0; seed < count; ++seed) windows.push_back(window_before(background, seed));
  return windows;
}

TEST(BackgroundMeter, FindsTheResponseWhateverThePackets) {
  const Background hall = made_up_background("hall", 3);
  BackgroundMeter meter;
  for (const auto& x : windows_before(hall, 400)) meter.add(x);
  const Background found = meter.background("found");
  EXPECT_EQ(found.name, "found");
  // The same up to a line and a gain: of 400 windows each element's mean is known to a twentieth of its deviation.
  const Sample left = departures(hall, found.response, kAllLinks);
  double ratio = 0;
  for (std::size_t e = 0; e < kElements; ++e) {
    EXPECT_LT(std::fabs(left[e]), 0.25 * hall.deviation[e]) << e;
    ratio += found.deviation[e] / hall.deviation[e] / kElements;
  }
  EXPECT_NEAR(ratio, 1, 0.05);
  EXPECT_NEAR(nearest_background({found}, window_before(hall, 1000), kAllLinks).unlikeness, 1, 0.3);
}

TEST(BackgroundMeter, KeepsSomeOfManyEvenly) {
  const auto windows = windows_before(made_up_background("hall", 3), 51);
  BackgroundMeter few, many;
  for (const auto& x : windows) few.add(x);
  for (std::size_t i = 0; i < 51 * 200; ++i) many.add(windows[i % windows.size()]);
  EXPECT_EQ(many.windows(), 10200u);
  const Background a = few.background(""), b = many.background("");
  for (std::size_t e = 0; e < kElements; ++e) ASSERT_NEAR(a.deviation[e] / b.deviation[e], 1, 0.05) << e;
}

TEST(BackgroundMeter, NamesWhatDoesNotVary) {
  const Background hall = made_up_background("hall", 3);
  BackgroundMeter meter, still;
  for (auto x : windows_before(hall, 20)) {
    for (std::size_t t = 0; t < kSamples; ++t) x[Window::index(7, t, 4)] = 0;
    meter.add(x);
  }
  for (int i = 0; i < 20; ++i) still.add(window_before(hall, 1));
  const auto words = [](const BackgroundMeter& of) {
    try {
      (void)of.background("den");
    } catch (const SetupError& error) {
      return std::string(error.what());
    }
    return std::string();
  };
  EXPECT_NE(words(meter).find("background of den can be had from 20 windows: subcarrier 7 of link 4"),
            std::string::npos)
      << words(meter);
  EXPECT_NE(words(still).find("does not vary"), std::string::npos);
  EXPECT_NE(words(BackgroundMeter()).find("from 0 windows"), std::string::npos);
}

TEST(ModelScaling, ReadsBackgrounds) {
  const std::vector<Background> written = {made_up_background("den", 1), made_up_background("hall", 2)};
  const auto model =
      testing::with_backgrounds(random_weights(preset_config("micro"), 5, HeadInit::random), written);
  const auto& read = model->normalisation().backgrounds;
  ASSERT_EQ(read.size(), 2u);
  for (std::size_t i = 0; i < 2; ++i) {
    EXPECT_EQ(read[i].name, written[i].name);
    EXPECT_EQ(read[i].response, written[i].response);
    EXPECT_EQ(read[i].deviation, written[i].deviation);
  }
}

TEST(ModelScaling, RefusesADeviationOfNothing) {
  Background flat = made_up_background("den", 1);
  flat.deviation[77] = 0;
  EXPECT_THROW(testing::with_backgrounds(random_weights(preset_config("micro"), 5, HeadInit::random), {flat}),
               SetupError);
}

// The same weights, once against a background and once by scalars of 1 of what is left of the window before it.
TEST(Engines, ScaleByTheBackground) {
  const auto bytes = random_weights(preset_config("micro"), 5, HeadInit::random);
  const Background own = made_up_background("own", 2);
  const auto plain = Model::from(SafetensorsFile::parse(bytes, "plain"));
  const auto model = testing::with_backgrounds(bytes, {made_up_background("other", 1), own});
  const std::vector<float> x = window_before(own, 7);
  const auto a = make_reference_engine(plain), b = make_reference_engine(model);
  for (const LinkSet links : {kAllLinks, LinkSet(0b111000111)}) {
    std::vector<float> tokens(kChannels * kSamples * links.count()), z(x.size());
    write_tokens(kPlain, {}, &own, x, links, tokens);
    std::size_t row = 0;
    for (std::size_t i = 0; i < kTokens; ++i) {
      if (!links[i % kLinks]) continue;
      for (std::size_t c = 0; c < kChannels; ++c) z[c * kTokens + i] = tokens[row * kChannels + c];
      ++row;
    }
    const NetworkOutput expected = a->run(z, links), got = b->run(x, links);
    for (std::size_t i = 0; i < expected.poses.size(); ++i)
      ASSERT_NEAR(got.poses[i], expected.poses[i], 1e-4) << i;
  }
}

}  // namespace
}  // namespace csipose
