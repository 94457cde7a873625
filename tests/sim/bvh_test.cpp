#include "sim/bvh.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>

#include "bvh_text.h"
#include "proto/result.h"
#include "sim/captured_scene.h"
#include "tests/counting_allocator.h"

namespace csipose::sim {
namespace {

/// The words with which `act` is refused.
template <class Act>
void expect_refusal(Act act, std::initializer_list<const char*> words) {
  try {
    act();
    ADD_FAILURE() << "accepted";
  } catch (const SetupError& error) {
    EXPECT_EQ(error.status, ExitStatus::bad_data);
    for (const char* word : words)
      EXPECT_NE(std::string(error.what()).find(word), std::string::npos) << error.what();
  }
}
void expect_refused_text(const std::string& text, std::initializer_list<const char*> words) {
  expect_refusal([&] { parse_bvh(text, "walk.bvh"); }, words);
}

void expect_near(const Vec3& a, const Vec3& b, double within = 1e-9) {
  EXPECT_LT(glm::distance(a, b), within) << fmt::format("({}, {}, {})", a.x, a.y, a.z);
}

CapturedMotion captured(const std::string& text, const CapturedMotion::Part& part = {},
                        const std::vector<Naming>& namings = built_in_namings()) {
  const BvhClip clip = parse_bvh(text, "walk.bvh");
  return {clip, find_landmarks(clip, namings), part, CounterRng(1, Purpose::persons, 0, 0, 0)};
}

TEST(Bvh, ReadsTreeAndFrames) {
  const BvhClip clip =
      parse_bvh(BvhWriter()({{{"Hips.Yposition", 95}}, {{"LeftArm.Xrotation", -30.5}}}), "walk.bvh");
  EXPECT_EQ(clip.joints[0].name, "Hips");
  EXPECT_EQ(clip.joints[0].channels, (std::vector<BvhClip::Channel>{0, 1, 2, 5, 3, 4}));
  EXPECT_EQ(clip.frames(), 2u);
  EXPECT_DOUBLE_EQ(clip.frame_s, 0.01);
  EXPECT_EQ(clip.position(0, 0), Vec3(0, 95, 0));
  EXPECT_EQ(clip.position(1, 0), Vec3(0, 0, 0));
  EXPECT_EQ(clip.position(0, 1), Vec3(0, 20, 0)) << "without channels the offset";
  const auto arm =
      std::find_if(clip.joints.begin(), clip.joints.end(), [](auto& j) { return j.name == "LeftArm"; });
  EXPECT_EQ(clip.joints[static_cast<std::size_t>(arm->parent)].name, "LeftShoulder");
  EXPECT_DOUBLE_EQ(clip.values[clip.channels + arm->first_value + 1], -30.5);
}

TEST(Bvh, TakesWhatProgramsWrite) {
  const BvhClip clip = parse_bvh(
      "hierarchy\r\nROOT Bip01 Pelvis {\r\n OFFSET +0 1e1 -.5 CHANNELS 1 XROTATION\r\n End Site Toe { OFFSET "
      "0 1 0 } }\r\n"
      "MOTION\r\nFrames:\t1\r\nFrame Time:0.0333\r\n\r\n 90 \r\n\r\n",
      "odd.bvh");
  EXPECT_EQ(clip.joints[0].name, "Bip01 Pelvis");
  EXPECT_EQ(clip.joints[0].offset, Vec3(0, 10, -0.5));
  EXPECT_TRUE(clip.joints[1].name.empty());
  EXPECT_EQ(clip.frames(), 1u);
}

TEST(Bvh, TurnsInTheOrderOfTheChannels) {
  const auto turned = [](const std::string& rotations) {
    const BvhClip clip =
        parse_bvh(BvhWriter(rotations)({{{"Hips.Zrotation", 90}, {"Hips.Xrotation", 90}}}), "walk.bvh");
    return clip.rotation(0, 0) * Vec3{0, 1, 0};
  };
  expect_near(turned("Zrotation Xrotation Yrotation"), {0, 0, 1});
  expect_near(turned("Xrotation Yrotation Zrotation"), {-1, 0, 0});
}

TEST(Bvh, RefusesAndSaysWhereAndWhatWouldBeRight) {
  const std::string good = BvhWriter()({{}, {}, {}});
  parse_bvh(good, "walk.bvh");
  expect_refused_text("", {"walk.bvh:1", "HIERARCHY", "cut off"});
  expect_refused_text("GIF89a", {"walk.bvh:1", "HIERARCHY", "GIF89a"});
  expect_refused_text(good.substr(0, 700), {"walk.bvh:", "the file ends"});
  expect_refused_text(good.substr(0, good.find("MOTION")), {"MOTION", "the file ends"});
  expect_refused_text(replaced(good, "Frames: 3", "Frames: 4"), {"after 3 of 4 frames", "cut off"});
  expect_refused_text(replaced(good, "Frames: 3", "Frames: 99999999999999999"),
                      {"after 3 of 99999999999999999"});
  expect_refused_text(replaced(good, "Frames: 3", "Frames: 2"), {"more follows", "2 frames"});
  expect_refused_text(replaced(good, "Frames: 3", "Frames: 0"), {"no frames"});
  expect_refused_text(replaced(good, "Frames: 3", "Frames: many"), {"whole number", "many"});
  expect_refused_text(replaced(good, "Frames: 3", "Frame: 3"), {"Frames:", "Frame: 3"});
  expect_refused_text(replaced(good, "Frame Time: 0.01", "Frame Time: 0"),
                      {"frame time of 0 s", "0.0001 .. 10"});
  expect_refused_text(replaced(good, "Frame Time: 0.01", "Frame Time: nan"), {"number", "nan"});
  expect_refused_text(replaced(good, "0.01\n0 ", "0.01\n0 0 "), {"frame 1", "numbers", "channels"});
  expect_refused_text(replaced(good, "0.01\n0 ", "0.01\n"), {"frame 1", "numbers", "channels"});
  expect_refused_text(replaced(good, "0.01\n0 ", "0.01\ninf "), {"number", "inf"});
  expect_refused_text(replaced(good, "0.01\n0 ", "0.01\n0,5 "), {"written with a point", "0,5"});
  expect_refused_text(replaced(good, "0.01\n0 ", "0.01\n1e7 "), {"too large"});
  expect_refused_text(replaced(good, "OFFSET 0 95 0", "OFFSET 0 95"), {"walk.bvh:5", "number", "CHANNELS"});
  expect_refused_text(replaced(good, "  OFFSET 0 95 0\n", ""), {"no OFFSET"});
  expect_refused_text(replaced(good, "CHANNELS 6", "CHANNELS 9"), {"walk.bvh:5", "9 channels", "at most 6"});
  expect_refused_text(replaced(good, "CHANNELS 6", "CHANNELS 5"), {"OFFSET, CHANNELS", "Yrotation"});
  expect_refused_text(replaced(good, "Xposition", "Xscale"), {"Xscale", "Xposition"});
  expect_refused_text(replaced(good, "Yposition", "Xposition"), {"'Xposition' twice"});
  expect_refused_text(replaced(good, "ROOT Hips", "ROOT"), {"no name"});
  expect_refused_text(replaced(good, "MOTION", "ROOT Other"), {"MOTION", "ROOT"});
}

TEST(Bvh, RefusesTreesThatGrowWithoutEnd) {
  std::string text = "HIERARCHY\nROOT a\n{\nOFFSET 0 0 0\n";
  for (int i = 0; i < 100'000; ++i) text += "JOINT a\n{\nOFFSET 0 0 0\n";
  expect_refused_text(text, {"more than 512 joints"});
}

TEST(Namings, TellProgramsApart) {
  const auto naming_of = [](const std::string& text) {
    const BvhClip clip = parse_bvh(text, "walk.bvh");
    return find_landmarks(clip, built_in_namings()).naming->name;
  };
  EXPECT_EQ(naming_of(BvhWriter()({{}})), "mixamo");
  EXPECT_EQ(naming_of(BvhWriter("Zrotation Xrotation Yrotation", "mixamorig:")({{}})), "mixamo");
  std::string text = BvhWriter()({{}});
  for (const auto& [from, to] : {std::pair{"UpLeg", "Hip"},
                                 {"Leg", "Knee"},
                                 {"Shoulder", "Collar"},
                                 {"ForeArm", "Elbow"},
                                 {"Arm", "Shoulder"}})
    while (text.find(from) != std::string::npos) text = replaced(text, from, to);
  EXPECT_EQ(naming_of(text), "anatomical");
  const MadeJoint person = made_person();
  MadeJoint cmu{"Hips",
                {0, 0, 0},
                {{"LHipJoint", {0, 0, 0}, {}}, {"RHipJoint", {0, 0, 0}, {}}, {"LowerBack", {0, 0, 0}, {}}}};
  cmu.children[2].children = person.children;
  const std::string made = replaced(BvhWriter()({{}}, 0.01, cmu), "JOINT Neck", "JOINT Neck1");
  EXPECT_EQ(naming_of(made), "cmu");
}

TEST(Namings, SayWhatIsMissingAndWhatIsThere) {
  const std::string text = replaced(BvhWriter()({{}}), "RightForeArm", "RightElbowThing");
  expect_refusal([&] { captured(text); },
                 {"walk.bvh", "'mixamo', lacks RightForeArm", "RightElbowThing", "--bvh-joints"});
}

TEST(Namings, RefuseTablesThatCannotBe) {
  const auto refused = [](const std::string& text, std::initializer_list<const char*> words) {
    expect_refusal([&] { parse_namings(text, "joints.json"); }, words);
  };
  refused("", {"joints.json", "not JSON"});
  refused("{}", {"no naming"});
  refused(R"({"a": {"joints": {"nose": "Nose"}}})", {"a.joints.nose", "left_hip"});
  refused(R"({"a": {"joints": {"neck": "Neck"}}})", {"a.joints", "lacks 'head'"});
  refused(R"({"a": {"joints": {"neck": 3}}})", {"a.joints.neck", "list"});
  refused(R"({"a": {"up": "x", "joints": {}}})", {"a.up", "y or z"});
  refused(R"({"a": {"metres_per_unit": 0, "joints": {}}})", {"a.metres_per_unit", "is 0; it must lie"});
  refused(R"({"a": {"scale": 1, "joints": {}}})", {"no key 'scale'", "metres_per_unit"});
}

TEST(Captured, StandsOnTheFloorAndLooksAhead) {
  CapturedMotion person = captured(BvhWriter()({{{"Hips.Xposition", 700}, {"Hips.Zposition", -300}}}));
  person.put({2, 1.5, 0}, 0);
  const Stance s = person.at(0);
  expect_near({s.pelvis.x, s.pelvis.y, 0}, {2, 1.5, 0});
  expect_near(s.pelvis_forward, {1, 0, 0});
  expect_near(s.hips[kLeft] - s.hips[kRight], {0, 0.18, 0});
  expect_near(s.knees[kLeft] - s.hips[kLeft], {0, 0, -0.41});
  expect_near(s.wrists[kRight] - s.shoulders[kRight], {0, -0.56, 0});
  expect_near(s.neck - s.pelvis, {0, 0, 0.53});
  expect_near(s.toes[kLeft], {1, 0, 0});
  expect_near(s.head_up, {0, 0, 1});
  expect_near(glm::normalize(s.hands[kLeft] - s.wrists[kLeft]), {0, 1, 0}, 1e-9);
  EXPECT_NEAR(person.figure().stature_m, (0.83 + 0.53) / 0.806, 1e-9);
  const auto bodies = bodies_of(person.figure(), s, {});
  double lowest_m = 9;
  for (const Body& body : bodies) lowest_m = std::min(lowest_m, body.centre.z - body.support_m({0, 0, 1}));
  EXPECT_NEAR(lowest_m, 0, 1e-9);
  EXPECT_NEAR(bodies[7].half_m.z, 0.41 * 0.132 / 0.245, 1e-9) << "the thigh is as long as the file's";
}

TEST(Captured, BendsWhereTheFileDoes) {
  const CapturedMotion person = captured(BvhWriter()({{{"LeftForeArm.Yrotation", -90},
                                                       {"RightUpLeg.Xrotation", -90},
                                                       {"RightLeg.Xrotation", 90},
                                                       {"Head.Xrotation", 30}}}));
  const Stance s = person.at(0);
  expect_near(s.wrists[kLeft] - s.elbows[kLeft], {0.25, 0, 0});
  expect_near(s.knees[kRight] - s.hips[kRight], {0.41, 0, 0});
  expect_near(s.ankles[kRight] - s.knees[kRight], {0, 0, -0.42});
  EXPECT_GT(s.head_up.x, 0.2) << "looks down";
}

TEST(Captured, TurnsEvenlyTheShortestWay) {
  const CapturedMotion person = captured(
      BvhWriter()({{{"Hips.Yrotation", 350}}, {{"Hips.Yrotation", 10}, {"Hips.Zposition", 100}}}, 0.1));
  for (double w = 0; w <= 1; w += 0.125) {
    const Stance s = person.at(0.1 * w);
    EXPECT_NEAR(std::atan2(s.pelvis_forward.y, s.pelvis_forward.x), (-10 + 20 * w) * std::acos(-1) / 180,
                1e-9);
  }
  EXPECT_NEAR(person.at(0.1).pelvis.x - person.at(0).pelvis.x, 1, 1e-9);
  expect_near(person.at(0.05).hips[kLeft], (person.at(0.04).hips[kLeft] + person.at(0.06).hips[kLeft]) / 2.0,
              1e-3);
  EXPECT_EQ(person.at(77).hands, person.at(0.1).hands) << "stays as the file ends";
  EXPECT_EQ(person.at(-1).hands, person.at(0).hands);
}

TEST(Captured, PlaysAPart) {
  std::vector<BvhFrame> frames;
  for (int i = 0; i <= 100; ++i) frames.push_back({{"Hips.Zposition", i}});
  const CapturedMotion part = captured(BvhWriter()(frames), {0.2, 0.5, {}, {}});
  EXPECT_NEAR(part.seconds(), 0.5, 1e-9);
  EXPECT_NEAR(part.way().x1 - part.way().x0, 0.5, 1e-9);
  expect_refusal([&] { captured(BvhWriter()(frames), {1.5, 1, {}, {}}); }, {"0 to 1.000 s", "1.5"});
}

/// Every bone of the person at t.
std::vector<double> bones(const Stance& s) {
  std::vector<double> lengths{glm::distance(s.hips[0], s.hips[1]),
                              glm::distance(s.shoulders[0], s.shoulders[1])};
  for (const std::size_t side : {kLeft, kRight})
    for (const auto& [a, b] : {std::pair{s.hips[side], s.knees[side]},
                               {s.knees[side], s.ankles[side]},
                               {s.shoulders[side], s.elbows[side]},
                               {s.elbows[side], s.wrists[side]}})
      lengths.push_back(glm::distance(a, b));
  return lengths;
}

TEST(Captured, KeepsItsBonesWhateverItDoes) {
  std::mt19937 random(3);
  std::uniform_real_distribution<double> angle(-60, 60);
  std::vector<BvhFrame> frames(50);
  for (BvhFrame& frame : frames)
    for (const char* joint :
         {"Hips", "Spine", "Neck", "LeftArm", "RightForeArm", "LeftUpLeg", "RightLeg", "LeftFoot"})
      for (const char* axis : {".Xrotation", ".Yrotation", ".Zrotation"})
        frame[joint + std::string(axis)] = angle(random);
  const CapturedMotion person = captured(BvhWriter()(frames));
  const std::vector<double> at_first = bones(person.at(0));
  double lowest_m = 9;
  for (int quarter = 0; quarter < 50 * 4; ++quarter) {
    const Stance s = person.at(0.0025 * quarter);
    const std::vector<double> now = bones(s);
    for (std::size_t i = 0; i < now.size(); ++i) EXPECT_NEAR(now[i], at_first[i], 1e-9);
    EXPECT_NEAR(glm::dot(glm::cross(s.forward, s.left), s.up), 1, 1e-9);
    EXPECT_NEAR(glm::length(s.toes[kLeft]), 1, 1e-9);
    for (const std::size_t foot : {9, 15}) {
      if (quarter % 4 != 0) continue;  // between frames of such a file a foot may come lower
      const Body body = bodies_of(person.figure(), s, {})[foot];
      lowest_m = std::min(lowest_m, body.centre.z - body.support_m({0, 0, 1}));
    }
  }
  EXPECT_NEAR(lowest_m, 0, 1e-9) << "a foot touches the floor";
}

TEST(Captured, RefusesWhoCannotBe) {
  const std::string text = BvhWriter()({{}});
  expect_refusal([&] { captured(text, {0, 1, 1.0, {}}); }, {"walk.bvh", "169 m tall", "--bvh-unit"});
  expect_refusal([&] { captured(replaced(text, "OFFSET 0 -41 0", "OFFSET 0 0 0")); },
                 {"left_hip and left_knee are 0.000 m apart"});
  std::string swapped = text;
  for (const auto& [from, to] :
       {std::pair{"Left", "#"}, {"Right", "Lef"}, {"#", "Right"}, {"Lef", "L%"}, {"L%", "Left"}})
    while (swapped.find(from) != std::string::npos && std::string(to).find(from) == std::string::npos)
      swapped = replaced(swapped, from, to);
  expect_refusal([&] { captured(swapped); }, {"feet point backward", "left and right"});
}

TEST(Captured, TakesAxesFromTheTable) {
  // The same person with z up and x ahead: every offset with its axes changed round.
  std::vector<Naming> namings = built_in_namings();
  for (Naming& naming : namings) naming.z_up = true;
  MadeJoint root = made_person();
  const auto change = [](auto self, MadeJoint& joint) -> void {
    joint.offset = {joint.offset[2], joint.offset[0], joint.offset[1]};
    for (MadeJoint& child : joint.children) self(self, child);
  };
  change(change, root);
  const Stance a = captured(BvhWriter()({{}})).at(0),
               b = captured(BvhWriter()({{}}, 0.01, root), {}, namings).at(0);
  expect_near(a.knees[kLeft], b.knees[kLeft]);
  expect_near(a.hands[kRight], b.hands[kRight]);
}

TEST(Captured, AllocatesNothingOnceItIsRead) {
  const CapturedMotion person =
      captured(BvhWriter()({{}, {{"Hips.Yrotation", 40}}, {{"LeftLeg.Xrotation", 40}}}));
  const std::uint64_t before = testing::allocations;
  double sum = 0;
  for (int i = 0; i < 100; ++i) sum += person.at(2e-4 * i).hands[kLeft].z;
  EXPECT_EQ(testing::allocations, before);
  EXPECT_GT(sum, 0);
}

TEST(Captured, AsksWhichWayIsUpWhenNobodyStands) {
  const std::string text =
      BvhWriter()({{{"Hips.Xrotation", 90}}});  // as exported by programs whose z points up
  expect_refusal([&] { captured(text); }, {"walk.bvh", "nobody stands", "--bvh-up z"});
  const Stance lying = captured(text, {0, 1, {}, false}).at(0),
               standing = captured(text, {0, 1, {}, true}).at(0);
  expect_near(lying.neck - lying.pelvis, {0.53, 0, 0});
  expect_near(standing.neck - standing.pelvis, {0, 0, 0.53});
}

RoomPlan free_room(double x_m, double y_m) {
  RoomPlan room;
  room.name = "free";
  room.area = {0.5, 0.5, 0.5 + x_m, 0.5 + y_m};
  return room;
}

TEST(PutInto, KeepsPeopleApartAndInside) {
  std::vector<BvhFrame> frames;
  for (int i = 0; i <= 200; ++i) frames.push_back({{"Hips.Zposition", i}});
  std::vector<std::unique_ptr<CapturedMotion>> people;
  for (int i = 0; i < 2; ++i)
    people.push_back(std::make_unique<CapturedMotion>(captured(BvhWriter()(frames))));
  const std::vector<std::filesystem::path> files{"a.bvh", "b.bvh"};
  put_into(free_room(2.2, 3.2), people, files);  // 2 m of way fit along y alone
  const Rectangle area{0.5, 0.5, 2.7, 3.7};
  for (double t = 0; t < 2; t += 0.05) {
    const Vec3 a = people[0]->at(t).pelvis, b = people[1]->at(t).pelvis;
    EXPECT_TRUE(area.holds(a, kInside_m - 1e-9) && area.holds(b, kInside_m - 1e-9));
    EXPECT_GT(std::hypot(a.x - b.x, a.y - b.y), kApartSpread_m - 0.01);
  }
  expect_refusal([&] { put_into(free_room(2.2, 2.2), people, files); },
                 {"a.bvh", "2.00 x 0.00 m", "2.20 x 2.20", "--bvh-from"});
}

}  // namespace
}  // namespace csipose::sim
