// proto/pose.h - joints of people in the room, and the frame that carries them to subscribers.
//
// Room frame: right-handed, metres, x along one wall, y into the room, z up, origin at a floor corner.
// Joint order: the PiW3D data set's, everywhere, from label to stream (model.md section 15 of the specification;
// aiotgroup/Person-in-WiFi-3D-repo result table).
#pragma once

#include <array>
#include <cstdint>
#include <limits>
#include <string_view>

#include "proto/shape.h"
#include "proto/window.h"

namespace csipose {

struct Point3 {
  float x = 0, y = 0, z = 0;  ///< metres
};
using Skeleton = std::array<Point3, kJoints>;

/// Places in a skeleton.
enum Joint : std::size_t {
  kNeck,
  kHead,
  kLeftShoulder,
  kRightShoulder,
  kLeftElbow,
  kLeftHip,
  kRightElbow,
  kRightHip,
  kLeftHand,
  kLeftKnee,
  kRightHand,
  kRightKnee,
  kLeftAnkle,
  kRightAnkle
};
inline constexpr std::array<std::string_view, kJoints> kJointNames = {
    "neck",      "head",      "left_shoulder", "right_shoulder", "left_elbow", "left_hip",   "right_elbow",
    "right_hip", "left_hand", "left_knee",     "right_hand",     "right_knee", "left_ankle", "right_ankle"};
inline constexpr std::array<std::array<std::uint8_t, 2>, 14> kBones = {{
    {kNeck, kHead},
    {kNeck, kLeftShoulder},
    {kNeck, kRightShoulder},
    {kLeftShoulder, kLeftElbow},
    {kLeftElbow, kLeftHand},
    {kRightShoulder, kRightElbow},
    {kRightElbow, kRightHand},
    {kLeftShoulder, kLeftHip},
    {kRightShoulder, kRightHip},
    {kLeftHip, kRightHip},
    {kLeftHip, kLeftKnee},
    {kLeftKnee, kLeftAnkle},
    {kRightHip, kRightKnee},
    {kRightKnee, kRightAnkle},
}};

/// Between the hips.
inline Point3 root_of(const Skeleton& joints) {
  const Point3 &l = joints[kLeftHip], &r = joints[kRightHip];
  return {(l.x + r.x) / 2, (l.y + r.y) / 2, (l.z + r.z) / 2};
}

inline constexpr float kUnknown = std::numeric_limits<float>::quiet_NaN();  ///< null in JSON, NaN in protobuf

struct Person {
  std::uint32_t id = 0;   ///< stable while tracked, never reused within a session; 0 = tracking off
  float score = 0;        ///< probability that this is a person
  Skeleton joints{};      ///< room frame, after smoothing
  Skeleton joints_raw{};  ///< before smoothing; meaningful only when the frame says `smoothed`
  std::array<float, kJoints>
      confidence{};  ///< probability of an error under 150 mm; NaN where the model has no such head
  std::array<float, kJoints> sigma_m{};  ///< expected error, metres; NaN likewise
  std::uint32_t age_ms = 0;              ///< time tracked

  Point3 root() const { return root_of(joints); }
};

enum class Source : std::uint8_t { live = 1, replay = 2, simulated = 3 };
enum class State : std::uint8_t {
  warmup = 1,
  empty = 2,
  tracking = 3,
  degraded = 4,
  stale = 5,
  paused = 6,
  fault = 7
};

/// Why a frame is not plain TRACKING or EMPTY. Numbers are those of csipose.proto's enum Reason.
enum class Reason : std::uint8_t {
  rx_missing = 1,
  gap = 2,
  skew = 3,
  nan_input = 4,
  deadline = 5,
  no_model = 6,
  untrained = 7,
  too_few_links = 8,
  mixed_width = 9,
  no_data = 10,
  clock_unknown = 11,
  unknown_installation = 12
};
/// A set of reasons, one bit each: 1 << number.
using Reasons = std::uint32_t;
constexpr Reasons reason_bit(Reason reason) { return Reasons{1} << static_cast<unsigned>(reason); }

enum class Stage : std::uint8_t { ingest, align, window, infer, publish };
inline constexpr std::size_t kStages = 5;

/// One published frame. Trivially copyable, so that rings between threads hold it by value.
struct PoseFrame {
  std::uint64_t seq = 0;  ///< +1 for each frame of this session
  std::uint64_t session =
      0;  ///< changes at each start; in a replay derived from recording, model and settings
  UtcTime window_start{}, window_end{}, published{};
  std::int64_t mono_ns = 0;          ///< steady clock at publication
  std::uint64_t clock_error_ns = 0;  ///< bound on UTC's error from the kernel's clock state; 0 = unknown
  Source source = Source::live;
  State state = State::warmup;
  Reasons reasons = 0;
  std::array<char, 12> model{};  ///< first hex digits of the weights' digest
  bool untrained = false;        ///< the weights are random
  bool smoothed = false;
  std::uint32_t people_count = 0;
  std::array<Person, kMaxPeople> people{};
  std::array<std::uint32_t, kStages>
      latency_us{};  ///< time spent per stage; all 0 in a replay, whose clock is the recording's
  std::array<ReceiverQuality, kReceivers> receivers{};
};

}  // namespace csipose
