#include "sim/counter_rng.h"

#include <gtest/gtest.h>

#include <cmath>
#include <numbers>

#include "tests/sim/golden.h"

namespace csipose::sim {
namespace {

// Known answers of the authors' Random123 library (kat_vectors, philox4x32 10).
TEST(Philox, GivesTheKnownAnswers) {
  EXPECT_EQ(philox4x32({0, 0, 0, 0}, {0, 0}), (PhiloxBlock{0x6627e8d5, 0xe169c58d, 0xbc57ac4c, 0x9b00dbd8}));
  constexpr std::uint32_t f = 0xffffffff;
  EXPECT_EQ(philox4x32({f, f, f, f}, {f, f}), (PhiloxBlock{0x408f276d, 0x41c83b0e, 0xa20bc7c6, 0x6d5451fd}));
  EXPECT_EQ(philox4x32({0x243f6a88, 0x85a308d3, 0x13198a2e, 0x03707344}, {0xa4093822, 0x299f31d0}),
            (PhiloxBlock{0xd16cfe09, 0x94fdcceb, 0x5001e420, 0x24126ea1}));
}

TEST(Philox, MeetsTheGoldenAnswers) {
  CSIPOSE_NEEDS_SHARED_DATA();
  for (const auto& kat : testing::golden_list("sampler.json", "philox_kat"))
    EXPECT_EQ(philox4x32(kat["ctr"].get<PhiloxBlock>(), kat["key"].get<std::array<std::uint32_t, 2>>()),
              kat["out"].get<PhiloxBlock>());
}

TEST(CounterRng, MeetsTheGoldenUniforms) {
  CSIPOSE_NEEDS_SHARED_DATA();
  const auto golden = testing::golden("sampler.json");
  CounterRng rng(golden["cases"][0]["scene"]["seed"].get<std::uint64_t>(), Purpose::room, 0, 0, 0);
  for (const double expected : golden["uniform_first8"][0].get<std::vector<double>>())
    EXPECT_DOUBLE_EQ(rng.uniform(0, 1), expected);
}

TEST(CounterRng, SameCounterSameNumbersOtherCounterOthers) {
  CounterRng a(7, Purpose::objects, 3, 2, 1), b(7, Purpose::objects, 3, 2, 1),
      c(7, Purpose::objects, 4, 2, 1);
  int equal_to_other = 0;
  for (int i = 0; i < 100; ++i) {
    const std::uint32_t word = a.word();
    EXPECT_EQ(word, b.word());
    equal_to_other += word == c.word();
  }
  EXPECT_EQ(equal_to_other, 0);
}

TEST(CounterRng, NormalHasTheMomentsOfANormal) {
  CounterRng rng(1, Purpose::clutter, 0, 0, 0);
  constexpr int kDraws = 100'000;
  double sum = 0, square = 0, fourth = 0;
  for (int i = 0; i < kDraws; ++i) {
    const double x = rng.normal();
    sum += x, square += x * x, fourth += x * x * x * x;
  }
  // Five standard errors each.
  EXPECT_NEAR(sum / kDraws, 0, 5 * std::sqrt(1.0 / kDraws));
  EXPECT_NEAR(square / kDraws, 1, 5 * std::sqrt(2.0 / kDraws));
  EXPECT_NEAR(fourth / kDraws, 3, 5 * std::sqrt(96.0 / kDraws));
}

TEST(CounterRng, IndexReachesEveryValueAndNoOther) {
  CounterRng rng(1, Purpose::room, 0, 0, 0);
  std::array<int, 6> seen{};
  for (int i = 0; i < 6000; ++i) {
    const std::uint32_t k = rng.index(6);
    ASSERT_LT(k, 6u);
    ++seen[k];
  }
  for (const int count : seen) EXPECT_NEAR(count, 1000, 5 * std::sqrt(1000 * 5 / 6.0));
}

}  // namespace
}  // namespace csipose::sim
