#include "sim/human_clip.h"

#include <algorithm>
#include <cassert>
#include <limits>

namespace csipose::sim {
namespace {

std::array<float, kMostPeople * kJoints * 3> label_row(const std::vector<Joints>& people) {
  std::array<float, kMostPeople * kJoints * 3> row;
  row.fill(std::numeric_limits<float>::quiet_NaN());
  std::size_t i = 0;
  for (const Joints& joints : people)
    for (const Vec3& joint : joints)
      for (int axis = 0; axis < 3; ++axis) row[i++] = static_cast<float>(joint[axis]);
  return row;
}

}  // namespace

std::vector<ArrayPlan> human_arrays(const FrameFormat& format) {
  std::vector<ArrayPlan> arrays = frame_arrays(format);
  arrays.push_back({"labels", "<f4", 4, {kMostPeople, kJoints, 3}});
  arrays.push_back({"count", "|u1", 1, {}});
  arrays.push_back({"action", "|u1", 1, {kMostPeople}});
  arrays.push_back({"room", "|u1", 1, {}});
  return arrays;
}

ClipRows make_human_clip(const HumanClip& clip, const FrameFormat& format, const Impairments& on,
                         std::uint64_t seed, double rate_hz) {
  assert(clip.spec.people <= kMostPeople);
  HumanScene scene(clip.spec, seed, clip.number, rate_hz);
  const bool known =
      clip.solver != nullptr && scene.still().furniture.size() == clip.spec.room.still.furniture.size();
  FrameMaker maker(known ? *clip.solver : FastSolver(scene.still()), format, on, seed, clip.number, rate_hz);
  ClipRows rows(human_arrays(format).size());
  const std::size_t labels = frame_arrays(format).size();
  const auto count = static_cast<std::uint8_t>(clip.spec.people);
  for (std::uint32_t frame = 0; frame < clip.frames; ++frame) {
    maker.add_frame(scene, rows);
    append(rows[labels], label_row(maker.people(label_sample(format))).data(), kMostPeople * kJoints * 3);
    append(rows[labels + 1], &count, 1);
    std::array<std::uint8_t, kMostPeople> actions;
    actions.fill(kNoAction);
    for (std::size_t i = 0; i < clip.spec.people; ++i)
      actions[i] = static_cast<std::uint8_t>(scene.action(i));
    append(rows[labels + 2], actions.data(), kMostPeople);
    append(rows[labels + 3], &clip.room_index, 1);
  }
  return rows;
}

std::vector<SimPiwClip> simpiw_clips(bool small) {
  // Frames by number of people: data set's own lists.
  static constexpr std::array<std::uint32_t, 3> kTrain{28'121, 36'242, 25'583}, kTest{2'586, 3'184, 2'054};
  constexpr std::uint32_t kClipFrames = 100;
  std::vector<SimPiwClip> clips;
  for (const bool test : {false, true})
    for (std::size_t people = 1; people <= 3; ++people) {
      const std::uint32_t all = (test ? kTest : kTrain)[people - 1];
      std::uint32_t left = small ? (all + 5) / 10 : all;
      for (std::uint8_t room = 0; left > 0;
           room = static_cast<std::uint8_t>((room + 1) % kSimPiwRooms.size())) {
        const std::uint32_t frames = std::min(left, kClipFrames);
        clips.push_back({room, people, frames, test});
        left -= frames;
      }
    }
  return clips;
}

}  // namespace csipose::sim
