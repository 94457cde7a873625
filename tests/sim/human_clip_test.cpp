#include "sim/human_clip.h"

#include <gtest/gtest.h>

#include <cstring>
#include <glm/gtc/packing.hpp>
#include <map>

#include "proto/result.h"
#include "sim/built_in_rooms.h"

namespace csipose::sim {
namespace {

template <class Number>
std::vector<Number> numbers(const std::vector<std::uint8_t>& bytes) {
  std::vector<Number> out(bytes.size() / sizeof(Number));
  std::memcpy(out.data(), bytes.data(), bytes.size());
  return out;
}

HumanClip clip_in(const char* room, std::size_t people, std::uint32_t frames) {
  return {{read_room_plan(room), people, {Action::walk, Action::wave}, false}, 4, frames, 2};
}

TEST(HumanClip, LabelsArePeopleAtTheMiddleOfEachFrame) {
  const HumanClip clip = clip_in("empty", 2, 2);
  const ClipRows rows = make_human_clip(clip, {Storage::half}, {}, 3, 300);
  ASSERT_EQ(rows.size(), human_arrays({Storage::half}).size());
  HumanScene scene(clip.spec, 3, 4, 300);
  MovingScene::Snapshot snapshot;
  std::vector<std::vector<Joints>> people;
  for (int i = 0; i < 40; ++i) scene.next(snapshot), people.push_back(snapshot.people);
  const auto labels = numbers<float>(rows[3]);
  ASSERT_EQ(labels.size(), 2 * kMostPeople * kJoints * 3);
  for (std::size_t frame = 0; frame < 2; ++frame)
    for (std::size_t p = 0; p < 2; ++p)
      for (std::size_t j = 0; j < kJoints; ++j)
        for (int axis = 0; axis < 3; ++axis)
          EXPECT_EQ(labels[((frame * 3 + p) * kJoints + j) * 3 + static_cast<std::size_t>(axis)],
                    static_cast<float>(people[frame * 20 + label_sample({})][p][j][axis]));
  EXPECT_TRUE(std::isnan(labels[2 * kJoints * 3])) << "there is no third";
  EXPECT_EQ(rows[4], (std::vector<std::uint8_t>{2, 2}));
  EXPECT_EQ(rows[5][2], kNoAction);
  EXPECT_EQ(rows[6], (std::vector<std::uint8_t>{2, 2}));
}

TEST(HumanClip, HalfPrecisionIsTheChannelOverItsRms) {
  const HumanClip clip = clip_in("empty", 1, 1);
  const auto exact = numbers<float>(make_human_clip(clip, {Storage::channel}, {}, 3, 300)[1]);
  const ClipRows half = make_human_clip(clip, {Storage::half}, {}, 3, 300);
  const auto bits = numbers<std::uint16_t>(half[1]);
  const float rms = numbers<float>(half[2])[0];
  ASSERT_EQ(bits.size(), exact.size());
  double power = 0;
  for (const float x : exact) power += double{x} * x;
  EXPECT_NEAR(rms, std::sqrt(power / (static_cast<double>(exact.size()) / 2)), 1e-6 * rms);
  double largest = 0;
  for (std::size_t i = 0; i < bits.size(); ++i)
    largest = std::max(largest, std::abs(double{glm::unpackHalf1x16(bits[i])} * rms - exact[i]) / rms);
  EXPECT_LT(largest, 4e-3) << "values up to 8 times the rms";
}

// Far apart or not, snapshots of the same people at the same instants have the same channel; what the fast solver interpolates is small.
TEST(HumanClip, FewSnapshotsSpreadOverAFrameAreItsInstants) {
  constexpr std::uint32_t kClips = 12;
  constexpr std::size_t kSpread = 4, kEvery = kSamples / kSpread;
  const FastSolver solver(HumanScene(clip_in("office", 1, 1).spec, 3, 0, 300).still());
  std::vector<std::vector<float>> dense, spread;
  for (std::uint32_t number = 0; number < kClips; ++number) {
    HumanClip clip = clip_in("office", 1, 1);
    clip.number = number;
    clip.solver = &solver;
    const ClipRows all = make_human_clip(clip, {Storage::channel}, {}, 3, 300),
                   few = make_human_clip(clip, {Storage::channel, kSpread}, {}, 3, 60);
    dense.push_back(numbers<float>(all[1]));
    spread.push_back(numbers<float>(few[1]));
    const auto label = numbers<float>(all[2]), few_label = numbers<float>(few[2]);
    for (std::size_t i = 0; i < kJoints * 3; ++i) ASSERT_NEAR(few_label[i], label[i], 1e-6);
  }
  const std::size_t row = dense[0].size() / kSamples;
  ASSERT_EQ(spread[0].size(), kSpread * row);
  double off = 0, people = 0;  // squares: beside what people add to the mean of the clips
  for (std::size_t t = 0; t < kSpread; ++t)
    for (std::size_t i = 0; i < row; ++i) {
      double mean = 0;
      for (const auto& h : dense) mean += double{h[t * kEvery * row + i]} / kClips;
      for (std::uint32_t clip = 0; clip < kClips; ++clip) {
        const double there = double{dense[clip][t * kEvery * row + i]};
        off += std::pow(double{spread[clip][t * row + i]} - there, 2);
        people += std::pow(there - mean, 2);
      }
    }
  EXPECT_LT(std::sqrt(off / people), 0.02);
  EXPECT_GT(people, 0);
}

TEST(HumanScene, FurnitureAndChairsStandStill) {
  HumanSpec spec = clip_in("office", 1, 1).spec;
  spec.allowed = {Action::sit};
  spec.chairs = true;
  const HumanScene scene(spec, 1, 0, 300);
  EXPECT_EQ(scene.still().furniture.size(), spec.room.still.furniture.size() + 1);
}

TEST(RandomRoom, HoldsItsAreaAndKeepsFurnitureOffDevices) {
  for (std::uint32_t clip = 0; clip < 60; ++clip)
    for (const bool opposite : {false, true}) {
      const RoomPlan plan = draw_room(9, clip, opposite);
      const Vec3& room = plan.still.room.size_m;
      EXPECT_TRUE(plan.area.x0 >= 0.2 && plan.area.y0 >= 0.2 && plan.area.x1 <= room.x - 0.2 &&
                  plan.area.y1 <= room.y - 0.2);
      ASSERT_EQ(plan.still.receivers.size(), kReceivers);
      for (const Body& body : plan.still.furniture)
        for (const auto& receiver : plan.still.receivers)
          EXPECT_GT(glm::distance(body.centre, receiver[1].position), 0.2);
      const HumanScene scene({plan, 2, {Action::stand}, false}, 9, clip, 300);
      EXPECT_EQ(scene.people(), 2u);
    }
}

TEST(SimPiw, HasThePublishedCounts) {
  std::map<std::pair<bool, std::size_t>, std::uint32_t> frames;
  std::map<std::uint8_t, std::uint32_t> rooms;
  for (const SimPiwClip& clip : simpiw_clips(false)) {
    frames[{clip.test, clip.people}] += clip.frames;
    rooms[clip.room] += clip.frames;
  }
  EXPECT_EQ((frames[{false, 1}] + frames[{false, 2}] + frames[{false, 3}]), 89'946u);
  EXPECT_EQ((frames[{true, 1}]), 2'586u);
  EXPECT_EQ((frames[{true, 2}]), 3'184u);
  EXPECT_EQ((frames[{true, 3}]), 2'054u);
  for (const auto& [room, count] : rooms) EXPECT_NEAR(count, (89'946 + 7'824) / 3.0, 300);
  std::uint32_t small = 0;
  for (const SimPiwClip& clip : simpiw_clips(true)) small += clip.frames;
  EXPECT_NEAR(small, 9'777, 3);
}

// Rooms.

TEST(RoomFile, TheBuiltInOnesAreRight) {
  ASSERT_EQ(built_in_rooms().size(), 4u);
  for (const BuiltInRoom& it : built_in_rooms()) {
    const RoomPlan plan = read_room_plan(std::string(it.name));
    EXPECT_EQ(plan.name, it.name);
    EXPECT_NEAR(plan.area.x1 - plan.area.x0, 4.0, 1e-9) << "the published area";
    EXPECT_NEAR(plan.area.y1 - plan.area.y0, 3.5, 1e-9);
  }
}

std::string refusal(std::string from, std::string to) {
  std::string json(built_in_rooms()[0].json);
  const auto at = json.find(from);
  EXPECT_NE(at, std::string::npos) << from;
  try {
    parse_room(json.replace(at, from.size(), to), "r.json");
  } catch (const SetupError& error) {
    EXPECT_EQ(error.status, ExitStatus::bad_data);
    return error.what();
  }
  return "accepted";
}

TEST(RoomFile, RefusesInWordsThatSayWhere) {
  EXPECT_EQ(refusal("[0.8, 0.65, 4.8, 4.15]", "[0.8, 0.65, 6, 4.15]"),
            "r.json: area: reaches beyond the room of 5.6 x 4.8 m");
  EXPECT_EQ(refusal("[0.8, 0.65, 4.8, 4.15]", "[0.8, 0.65, 1.8, 4.15]"),
            "r.json: area: must be at least 1.5 x 1.5 m: people keep 0.45 m inside it");
  EXPECT_EQ(refusal("[0.65, 2.4, 1.2]", "[0.4, 1.0, 0.73]"),
            "r.json: furniture[0]: the transmitter stands in it");
  EXPECT_EQ(refusal("[4.95, 2.4, 1.2]", "[5.3, 0.8, 1.0]"), "r.json: furniture[3]: receiver 1 stands in it");
  EXPECT_NE(refusal("[4.95, 2.4, 1.2]", "[5.95, 2.4, 1.2]").find("rx[0]: an antenna at"), std::string::npos);
  EXPECT_NE(
      refusal("\"metal\"", "\"unobtainium\"").find("furniture[3].mat: there is no material 'unobtainium'"),
      std::string::npos);
  EXPECT_NE(refusal("\"area\"", "\"aera\"").find("has no key 'aera'"), std::string::npos);
  EXPECT_NE(
      refusal("[5.38, 0.75, 0.9]", "[5.48, 0.75, 0.9]").find("furniture[3]: this piece of furniture at"),
      std::string::npos);
}

}  // namespace
}  // namespace csipose::sim
