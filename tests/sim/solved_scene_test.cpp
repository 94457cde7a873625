#include "sim/solved_scene.h"

#include <gtest/gtest.h>

#include "sim/human_scene.h"
#include "sim/reflector.h"

namespace csipose::sim {
namespace {

TEST(ReflectorScene, RunsOnItsGrid) {
  const auto scene = reflector_channels(300);
  EXPECT_EQ(scene->people(), 0u);
  for (int n = 0; n < 3; ++n) {
    const Channel expected = reflector_channel(default_reflector_scene(Band{}), Band{}, n / 300.0);
    EXPECT_EQ(scene->next().channel, expected);
  }
}

std::unique_ptr<MovingScene> walker() {
  return std::make_unique<HumanScene>(HumanSpec{read_room_plan("empty"), 1, {Action::walk}, false}, 1, 0,
                                      300);
}

TEST(SolvedScene, APersonMovesTheChannelAndStaysInTheRoom) {
  const auto scene = solve_as_it_moves(walker());
  ASSERT_EQ(scene->people(), 1u);
  const Instant first = scene->next();
  Instant last = first;
  double largest_step = 0, level = 0;
  for (int n = 1; n < 40; ++n) {
    const Instant now = scene->next();
    for (std::size_t r = 0; r < kReceivers; ++r) {
      largest_step = std::max(largest_step, std::abs(now.channel[r][10][1] - last.channel[r][10][1]));
      level = std::max(level, std::abs(now.channel[r][10][1]));
    }
    for (const Vec3& joint : now.people[0]) {
      ASSERT_TRUE(joint.x > 0.2 && joint.x < 4.4 && joint.y > 0.2 && joint.y < 3.9 && joint.z > 0 &&
                  joint.z < 1.9);
    }
    last = now;
  }
  EXPECT_GT(glm::distance(first.people[0][0], last.people[0][0]), 0.02);
  EXPECT_GT(largest_step, 1e-3 * level) << "something moves";
  EXPECT_LT(largest_step, 0.5 * level) << "nothing jumps, batches included";
}

}  // namespace
}  // namespace csipose::sim
