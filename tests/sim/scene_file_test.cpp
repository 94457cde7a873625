#include "sim/scene_file.h"

#include <gtest/gtest.h>

#include "proto/result.h"

namespace csipose::sim {
namespace {

const std::string kRoom = R"("L": [5, 4, 3], "materials": {
  "x0": {"name": "concrete"}, "x1": {"name": "wood"}, "y0": {"name": "glass", "thickness": 0.01},
  "y1": {"name": "wood"}, "z0": {"name": "concrete", "thickness": 0.3}, "z1": {"name": "plasterboard"}})";
const std::string kDevices = R"("tx": [0.1, 2, 1], "rx": [{"center": [4.9, 2, 1], "axis": [0, 2, 0]}])";

Scene parse(const std::string& inside) { return parse_scene("{" + inside + "}", "s.json"); }

/// The words with which a scene is refused.
std::string refusal(const std::string& inside) {
  try {
    parse(inside);
  } catch (const SetupError& error) {
    EXPECT_EQ(error.status, ExitStatus::bad_data);
    return error.what();
  }
  return "accepted";
}
void expect_refusal(const std::string& inside, std::initializer_list<const char*> words) {
  const std::string said = refusal(inside);
  for (const char* word : words) EXPECT_NE(said.find(word), std::string::npos) << said;
}

TEST(SceneFile, HasDefaultsForWhatIsNotSaid) {
  const Scene scene = parse(kRoom + "," + kDevices);
  EXPECT_EQ(scene.wall_order, 3);
  EXPECT_EQ(scene.pairs, 13);
  EXPECT_EQ(scene.snapshots, 20);
  EXPECT_DOUBLE_EQ(scene.step_s, 1 / 300.0);
  EXPECT_EQ(scene.tones, intel5300_tones());
  EXPECT_TRUE(scene.walls);
  EXPECT_DOUBLE_EQ(scene.room.surface(Wall::y0).thickness_m, 0.01);
  EXPECT_DOUBLE_EQ(scene.room.surface(Wall::x0).thickness_m, 0.20);
  ASSERT_EQ(scene.receivers.size(), 1u);
  ASSERT_EQ(scene.receivers[0].size(), 3u);
  const Vec3 step = scene.receivers[0][2].position - scene.receivers[0][1].position;
  EXPECT_NEAR(step.y, scene.wavelength_m() / 2, 1e-12);
}

TEST(SceneFile, TakesEveryKey) {
  const Scene scene =
      parse(kRoom + R"(, "name": "n", "fc": 5.32e9, "rate": 400, "snapshots": 5, "order": 1, "pairs": 49,
    "pattern": "iso", "spacing": 0.05, "antennas": 1, "subcarriers": [-10, 0, 10], "tx": [0.1, 2, 1], "tx_axis": [0, 1, 1],
    "rx": [{"center": [4.9, 2, 1]}], "bodies": [{"kind": "box", "c": [2, 2, 1], "h": [0.1, 0.2, 0.3], "mat": "metal", "v": [0, 1, 0]}])");
  EXPECT_EQ(scene.carrier_hz, 5.32e9);
  EXPECT_EQ(scene.tones, (std::vector<double>{-10, 0, 10}));
  EXPECT_EQ(scene.receivers[0].size(), 1u);
  EXPECT_EQ(scene.pairs, 49);
  EXPECT_EQ(scene.bodies[0].start.shape, Shape::box);
  EXPECT_DOUBLE_EQ(scene.bodies[0].at(0.5).centre.y, 2.5);
}

TEST(SceneFile, WithoutARoomIsFreeSpace) {
  EXPECT_FALSE(parse(R"("tx": [-5, 0, 0], "rx": [{"center": [5, 0, 0], "axis": [0, 1, 0]}])").walls);
}

TEST(SceneFile, RefusesAndSaysWhereAndWhatWouldBeRight) {
  expect_refusal("", {"s.json", "lacks 'tx'"});
  expect_refusal("\"tx\" 1", {"not JSON"});
  expect_refusal(kRoom + "," + kDevices + R"(, "colour": 1)", {"colour", "snapshots"});
  expect_refusal(kRoom + "," + kDevices + R"(, "order": "three")", {"order", "whole number"});
  expect_refusal(kRoom + "," + kDevices + R"(, "order": 99)", {"order", "99", "0 .. 8"});
  expect_refusal(kRoom + "," + kDevices + R"(, "pairs": 7)", {"pairs", "1, 13 or 49"});
  expect_refusal(kRoom + "," + kDevices + R"(, "rate": 300, "dt": 1)", {"rate", "dt"});
  expect_refusal(kRoom + "," + kDevices + R"(, "pattern": "yagi")", {"yagi", "hw_dipole"});
  expect_refusal(kRoom + R"(, "tx": [0.1, 2], "rx": [])", {"tx", "three numbers"});
  expect_refusal(kRoom + R"(, "tx": [0.1, 2, 1], "rx": [])", {"rx", "at least one"});
  expect_refusal(kRoom + R"(, "tx": [-0.1, 2, 1], "rx": [{"center": [4.9, 2, 1], "axis": [0, 1, 0]}])",
                 {"tx", "the transmitter", "not inside the room"});
  expect_refusal(kRoom + R"(, "tx": [0.1, 2, 1], "rx": [{"center": [4.99, 2, 1], "axis": [1, 0, 0]}])",
                 {"rx[0]", "antenna"});
  expect_refusal(kRoom + R"(, "tx": [0.1, 2, 1], "rx": [{"center": [4.9, 2, 1], "axis": [0, 0, 0]}])",
                 {"rx[0].axis", "zero"});
  expect_refusal(R"("materials": {}, )" + kDevices, {"no room size"});
  expect_refusal(R"("L": [5, 4, 3], "materials": {"x0": {"name": "jelly"}}, )" + kDevices,
                 {"materials.x0.name", "jelly", "plasterboard"});
}

TEST(SceneFile, RefusesBodiesThatCannotBe) {
  const std::string rest = kRoom + "," + kDevices + ", \"bodies\": [";
  expect_refusal(rest + R"({"kind": "torus", "c": [2, 2, 1], "mat": "wood"}])",
                 {"bodies[0].kind", "torus", "cylinder"});
  expect_refusal(rest + R"({"kind": "sphere", "c": [2, 2, 1], "r": 0.2, "mat": "cheese"}])",
                 {"bodies[0].mat", "cheese"});
  expect_refusal(rest + R"({"kind": "sphere", "c": [0.1, 2, 1], "r": 0.2, "mat": "wood"}])",
                 {"bodies[0]", "not inside"});
  expect_refusal(rest + R"({"kind": "sphere", "c": [2, 2, 1], "r": 0.2, "mat": "wood", "v": [90, 0, 0]}])",
                 {"snapshot 19"});
  expect_refusal(rest + R"({"kind": "sphere", "c": [2, 2, 1], "r": -1, "mat": "wood"}])",
                 {"bodies[0].r", "0.005"});
  expect_refusal(rest + R"({"kind": "sphere", "c": [2, 2, 1], "r": 0.2, "h": [1, 1, 1], "mat": "wood"}])",
                 {"no key 'h'"});
  expect_refusal(
      rest + R"({"kind": "box", "c": [2, 2, 1], "h": [0.1, 0.1, 0.1], "q": [0, 0, 0, 0], "mat": "wood"}])",
      {"bodies[0].q", "zero"});
  expect_refusal(rest + R"("ball"])", {"bodies[0]"});
}

TEST(SceneFile, SaysWhenThereIsNoFile) {
  try {
    read_scene("/nonexistent/scene.json");
    FAIL();
  } catch (const SetupError& error) {
    EXPECT_EQ(error.status, ExitStatus::no_input);
  }
}

}  // namespace
}  // namespace csipose::sim
