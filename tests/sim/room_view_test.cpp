// Pictures: a thing is drawn where it is, and the same picture each time.
#include "sim/room_view.h"

#include <gtest/gtest.h>

#include <cmath>

#include "sim/material.h"
#include "sim/picture.h"
#include "tests/sim/mixed_scene.h"

namespace csipose::sim {
namespace {

std::array<int, 3> pixel(const Pixels& picture, const glm::dvec2& at) {
  const auto i = (static_cast<std::size_t>(at.y) * static_cast<std::size_t>(picture.width) +
                  static_cast<std::size_t>(at.x)) *
                 3;
  return {picture.rgb[i], picture.rgb[i + 1], picture.rgb[i + 2]};
}

TEST(Camera, ProjectsWhereItsRaysGo) {
  const Camera camera = camera_around({{0, 0, 0}, {5, 4, 2.5}}, -1, 0.5, {20, 30}, {300, 220});
  for (const Vec3& p : {Vec3{1, 1, 1}, Vec3{4.9, 0.1, 0}, Vec3{2, 3, 2.4}}) {
    const auto px = camera.project(p);
    ASSERT_TRUE(px);
    EXPECT_GT(px->x, 20 - 1e-6);
    EXPECT_LT(px->x, 300 + 1e-6);
    EXPECT_GT(px->y, 30 - 1e-6);
    EXPECT_LT(px->y, 220 + 1e-6);
    EXPECT_LT(glm::distance(camera.ray(px->x, px->y), glm::normalize(p - camera.eye)), 1e-12);
  }
  EXPECT_FALSE(camera.project(camera.eye - camera.forward));
}

class View : public ::testing::Test {
 protected:
  static constexpr Colour kPaper{1, 1, 1};
  Scene scene_ = mixed_scene();
  RoomView view_{scene_};
  Camera camera_ = camera_around(view_.extent({}), -1, 0.5, {10, 10}, {310, 190});
  Pixels draw(const std::vector<Body>& bodies, const std::vector<Colour>& colours) const {
    return view_.draw(camera_, 320, 200, bodies, colours, kPaper);
  }
};

TEST_F(View, AThingIsWhereTheCameraProjectsIt) {
  Body ball;
  ball.centre = {2.5, 2, 1};
  ball.half_m = Vec3{0.3};
  const Pixels empty = draw({}, {}), with = draw({ball}, {{0, 0, 0.8f}});
  const glm::dvec2 middle = *camera_.project(ball.centre);
  const auto seen = pixel(with, middle), behind = pixel(empty, middle);
  EXPECT_GT(seen[2], 2 * seen[0] + 50) << "a blue ball";
  EXPECT_LT(std::abs(behind[2] - behind[0]), 30) << "a grey wall or floor";
  // Two radii aside nothing of it is seen; below it lies its shadow.
  const auto beside = *camera_.project(ball.centre + 0.6 * camera_.right);
  EXPECT_LT(std::abs(pixel(with, beside)[2] - pixel(empty, beside)[2]), 25);
  EXPECT_EQ(pixel(empty, {1, 1}), (std::array<int, 3>{255, 255, 255})) << "paper beside the room";
  double shade = 0;
  for (std::size_t i = 0; i < with.rgb.size(); i += 3) shade += empty.rgb[i] - with.rgb[i] > 8 ? 1 : 0;
  const double radius_px = glm::distance(*camera_.project(ball.centre + 0.3 * camera_.right), middle);
  EXPECT_GT(shade, 1.2 * 3.14 * radius_px * radius_px) << "the ball and a shadow";
}

TEST_F(View, NearWallsAreLeftAwayAndFarOnesAreThere) {
  const Pixels empty = draw({}, {});
  for (const Vec3& inside : {Vec3{2.5, 2, 0.1}, Vec3{1, 3, 1}, Vec3{1, 1, 0.05}})
    EXPECT_NE(pixel(empty, *camera_.project(inside)), (std::array<int, 3>{255, 255, 255}));
}

TEST_F(View, IsTheSameEachTime) {
  Body box;
  box.shape = Shape::box;
  box.centre = {2, 2, 0.5};
  box.half_m = {0.3, 0.2, 0.5};
  EXPECT_EQ(draw({box}, {{1, 0, 0}}).rgb, draw({box}, {{1, 0, 0}}).rgb);
}

TEST(ScenePlayer, KeepsThePastInOrder) {
  Scene scene = mixed_scene();
  scene.step_s = 1 / 300.0;
  ScenePlayer player(stated_scene(scene), scene.step_s, 30 / 300.0);
  player.run_to(45);
  EXPECT_NEAR(player.time_s(), 0.15, 1e-12);
  ASSERT_EQ(player.channel().size(), 30u);
  EXPECT_LT(glm::distance(player.bodies()[0].centre, scene.bodies[0].at(0.15).centre), 1e-12);
  scene.snapshots = 60;
  const auto h = solve_fast(scene);
  const std::size_t row = h.size() / 60;
  double error = 0, power = 0;
  for (std::size_t i = 0; i < 30; ++i)
    for (std::size_t j = 0; j < row; ++j) {
      error = std::max(error, double{std::abs(player.channel()[i][j] - h[(16 + i) * row + j])});
      power += std::norm(h[(16 + i) * row + j]) / static_cast<double>(30 * row);
    }
  EXPECT_LT(error, 1e-2 * std::sqrt(power)) << "the same but for the ends of batches";
}

}  // namespace
}  // namespace csipose::sim
