#include "sim/object_clip.h"

#include <gtest/gtest.h>

#include "sim/material.h"
#include "tests/sim/golden_scene.h"

namespace csipose::sim {
namespace {

void expect_near(const Vec3& got, const nlohmann::json& expected, double tolerance) {
  EXPECT_LT(glm::distance(got, vec3(expected)), tolerance) << expected;
}

void expect_rotation(const glm::dquat& got, const nlohmann::json& expected) {
  const glm::dquat q(expected[3].get<double>(), expected[0].get<double>(), expected[1].get<double>(),
                     expected[2].get<double>());
  EXPECT_NEAR(std::abs(glm::dot(got, q)), 1, 1e-12);
}

void expect_object(const FlyingObject& object, const nlohmann::json& golden) {
  const char* kinds[] = {"sphere", "cube", "cylinder", "ellipsoid"};
  EXPECT_EQ(kinds[static_cast<int>(object.kind)], golden["shape"].get<std::string>());
  EXPECT_NEAR(object.radius_m, golden["r"].get<double>(), 1e-12);
  EXPECT_EQ(object.material->name, golden["mat"].get<std::string>());
  expect_near(object.position, golden["pos"], 1e-12);
  expect_near(object.velocity_m_s, golden["vel"], 1e-12);
  expect_near(object.spin_rad_s, golden["omega"], 1e-12);
  expect_rotation(object.rotation, golden["quat"]);
  const Body body = object.body(surface_of("wood"));
  if (golden.contains("axes")) expect_near(body.half_m, golden["axes"], 1e-12);
  if (golden.contains("cyl_r")) {
    EXPECT_NEAR(body.half_m.x, golden["cyl_r"].get<double>(), 1e-12);
    EXPECT_NEAR(body.half_m.z, golden["cyl_hh"].get<double>(), 1e-12);
  }
}

TEST(ObjectClip, MeetsTheGoldenScenesAndFlights) {
  CSIPOSE_NEEDS_SHARED_DATA();
  for (const auto& c : testing::golden_list("sampler.json", "cases")) {
    const auto& golden = c["scene"];
    ObjectClip clip =
        sample_object_clip(golden["seed"].get<std::uint64_t>(), golden["clip"].get<std::uint32_t>());
    expect_near(clip.room_m, golden["L"], 1e-12);
    for (std::size_t w = 0; w < kWalls; ++w)
      EXPECT_EQ(clip.walls[w]->name, golden["mats"][std::string(kWallNames[w])].get<std::string>());
    expect_near(clip.devices[0].position, golden["tx"]["pos"], 1e-12);
    for (std::size_t r = 0; r < kReceivers; ++r) {
      EXPECT_EQ(clip.devices[r + 1].wall, golden["rx"][r]["wall"].get<std::uint32_t>());
      expect_near(clip.devices[r + 1].position, golden["rx"][r]["pos"], 1e-12);
    }
    ASSERT_EQ(clip.objects.size(), golden["objects"].size());
    for (std::size_t i = 0; i < clip.objects.size(); ++i)
      expect_object(clip.objects[i], golden["objects"][i]);

    int done = 0;
    for (const auto& trace : c["trace"]) {
      for (; done < trace["step"].get<int>(); ++done) clip.step(0.0025);
      for (std::size_t i = 0; i < clip.objects.size(); ++i) {
        expect_near(clip.objects[i].position, trace["pos"][i], 1e-9);
        expect_near(clip.objects[i].velocity_m_s, trace["vel"][i], 1e-9);
        expect_rotation(clip.objects[i].rotation, trace["quat"][i]);
      }
    }
  }
}

// Whatever is drawn, the solver can be asked: devices in the room, objects in it and apart from each other.
TEST(ObjectClip, ObjectsStayInTheRoomAndKeepTheirSpeed) {
  for (std::uint32_t number = 0; number < 200; ++number) {
    ObjectClip clip = sample_object_clip(99, number);
    ASSERT_LE(clip.objects.size(), 4u);
    for (int step = 0; step < 200; ++step) clip.step(1 / 300.0);
    for (const FlyingObject& object : clip.objects) {
      for (int axis = 0; axis < 3; ++axis) {
        ASSERT_GE(object.position[axis], object.radius_m - 1e-9);
        ASSERT_LE(object.position[axis], clip.room_m[axis] - object.radius_m + 1e-9);
      }
      ASSERT_LE(glm::length(object.velocity_m_s), 3 + 1e-9);
      ASSERT_NEAR(object.body(surface_of("wood")).bounding_radius_m(), object.radius_m, 1e-9);
    }
  }
}

TEST(ObjectClip, ScenesHaveTheirAntennasAlongTheirWalls) {
  const ObjectClip clip = sample_object_clip(5, 0);
  const Scene scene = random_room(clip.room_m, clip.walls, clip.devices);
  ASSERT_EQ(scene.receivers.size(), kReceivers);
  for (std::size_t r = 0; r < kReceivers; ++r) {
    const Vec3 step = scene.receivers[r][2].position - scene.receivers[r][0].position;
    EXPECT_NEAR(glm::length(step), scene.wavelength_m(), 1e-12);
    EXPECT_NEAR(clip.devices[r + 1].wall < 2 ? step.x : step.y, 0, 1e-12);
    EXPECT_NEAR(step.z, 0, 1e-12);
  }
}

}  // namespace
}  // namespace csipose::sim
