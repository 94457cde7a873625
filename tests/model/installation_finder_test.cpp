#include "model/installation_finder.h"

#include <gtest/gtest.h>

#include "model/seeded_random.h"
#include "tests/model/made_up_background.h"

namespace csipose {
namespace {

using testing::made_up_background;
using testing::window_before;

const LinkSet kAll = LinkSet().set(), kOneReceiver(0b111);

/// Another installation that differs by a part of what people do.
Background beside(Background background, double share) {
  SeededRandom random(5, "beside", {});
  background.name += "'s neighbour";
  for (std::size_t e = 0; e < kFirstPhase; ++e)
    background.response[e] += static_cast<float>(share * random.normal()) * background.deviation[e];
  return background;
}

class Finder : public ::testing::Test {
 protected:
  NearestBackground next(const Background& from, LinkSet links,
                         std::chrono::milliseconds later = std::chrono::milliseconds(67)) {
    x_ = window_before(from, ++seed_);
    return finder_.add(x_, links, now_ += later);
  }
  /// Of the last window alone.
  const Background* alone(LinkSet links) const { return nearest_background(known_, x_, links).background; }

  const std::vector<Background> known_ = {made_up_background("hall", 2),
                                          beside(made_up_background("hall", 2), 0.1),
                                          made_up_background("den", 3)};
  InstallationFinder finder_{known_};

 private:
  std::vector<float> x_;
  std::uint64_t seed_ = 0;
  SteadyTime now_{};
};

TEST_F(Finder, TheFirstWindowIsJudgedAlone) {
  for (const Background& from : known_) {
    const NearestBackground found = next(from, kAll);
    EXPECT_EQ(found.background, alone(kAll));
    EXPECT_NEAR(found.unlikeness, 1, 0.4);
    finder_.reset();
  }
}

TEST_F(Finder, ManyWindowsTellWhatOneDoesNot) {
  int mistaken_alone = 0, mistaken = 0;
  for (int i = 0; i < 200; ++i) {
    const NearestBackground found = next(known_[1], kOneReceiver);
    mistaken_alone += alone(kOneReceiver) != &known_[1];
    if (i >= 100) mistaken += found.background != &known_[1];
  }
  EXPECT_GT(mistaken_alone, 20) << "or the case is too easy";
  EXPECT_EQ(mistaken, 0);
}

TEST_F(Finder, UnlikenessIsThatOfTheLastSeconds) {
  const Background elsewhere = made_up_background("elsewhere", 9);
  const double once = next(elsewhere, kAll).unlikeness;
  EXPECT_GT(once, 10) << "neither gain nor phase of another place fits";
  for (int i = 0; i < 20; ++i) next(known_[2], kAll, std::chrono::seconds(5));
  const NearestBackground found = next(known_[2], kAll);
  EXPECT_EQ(found.background, &known_[2]);
  EXPECT_LT(found.unlikeness, 1.5);
}

TEST_F(Finder, WithoutBackgroundsNothingIsFound) {
  const std::vector<Background> none;
  InstallationFinder finder(none);
  const NearestBackground found = finder.add(window_before(known_[0], 1), kAll, SteadyTime{});
  EXPECT_EQ(found.background, nullptr);
  EXPECT_EQ(found.unlikeness, 0);
}

}  // namespace
}  // namespace csipose
