// sim/human_clip.h - clips of people for data sets: the frames of object_clip's kind, and labels.
#pragma once

#include "sim/frame_maker.h"
#include "sim/human_scene.h"

namespace csipose::sim {

inline constexpr std::size_t kMostPeople = 3;
inline constexpr std::uint8_t kNoAction = 255;

/// The arrays of a frame: those of frame_arrays(), then labels (people by joint by x, y, z; not a number where nobody is) at
/// label_sample(), their count, what each does, and the room.
std::vector<ArrayPlan> human_arrays(const FrameFormat& format);
/// The middle of a frame: 10 of 20.
constexpr std::size_t label_sample(const FrameFormat& format) { return format.snapshots / 2; }

/// One clip: a scene and how much of it.
struct HumanClip {
  HumanSpec spec;
  std::uint32_t number = 0;  ///< of the clip in its set: decides what people do and what the radio spoils
  std::uint32_t frames = 0;
  std::uint8_t room_index = 0;  ///< into the set's list of rooms
  const FastSolver* solver =
      nullptr;  ///< of the room, when it serves many clips; not used where a clip adds chairs
};
ClipRows make_human_clip(const HumanClip& clip, const FrameFormat& format, const Impairments& on,
                         std::uint64_t seed, double rate_hz);

/// simpiw, the counterpart of the published set Person-in-WiFi 3D (Yan et al., CVPR 2024): its counts of frames by people, whole
/// clips held out for test, three rooms in turn. A tenth of it with `small`.
struct SimPiwClip {
  std::uint8_t room = 0;  ///< into kSimPiwRooms
  std::size_t people = 1;
  std::uint32_t frames = 0;
  bool test = false;
};
inline constexpr std::array<const char*, 3> kSimPiwRooms{"office", "classroom", "corridor"};
std::vector<SimPiwClip> simpiw_clips(bool small);

}  // namespace csipose::sim
