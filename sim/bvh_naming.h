// sim/bvh_naming.h - which joint of a motion capture file is which of ours.
//
// Every program names its joints in its own way. A table, a JSON file (docs/simulator-motion.md), holds one or more namings;
// those that are common come with the program (sim/bvh_namings.json).
#pragma once

#include <array>
#include <optional>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include "sim/bvh.h"

namespace csipose::sim {

/// What must be found in a file; of the limbs the left one, then the right one.
inline constexpr std::size_t kNeckMark = 0, kHeadMark = 1, kShoulderMark = 2, kElbowMark = 4, kWristMark = 6,
                             kHipMark = 8, kKneeMark = 10, kAnkleMark = 12, kLandmarks = 14;
inline constexpr std::array<std::string_view, kLandmarks> kLandmarkNames{
    "neck",        "head",     "left_shoulder", "right_shoulder", "left_elbow", "right_elbow", "left_wrist",
    "right_wrist", "left_hip", "right_hip",     "left_knee",      "right_knee", "left_ankle",  "right_ankle"};

struct Naming {
  std::string name;
  double metres_per_unit = 0.01;
  bool z_up = false;             ///< else y
  std::vector<std::string> has;  ///< joints by which a file of this naming is told from others
  std::array<std::vector<std::string>, kLandmarks> joints;  ///< any of these
};

/// Throws SetupError (bad_data) that names the place in the file.
std::vector<Naming> parse_namings(std::string_view text, const std::string& file_name);
std::vector<Naming> read_namings(const std::filesystem::path& file);
const std::vector<Naming>& built_in_namings();

/// Joints of one file by landmark.
struct Landmarks {
  const Naming* naming = nullptr;
  std::array<std::size_t, kLandmarks> joint{};
};
/// By the naming that fits, of several the one that `has` most; throws SetupError (bad_data) that says what is missing and what the file has. Upper and lower
/// case are the same, and what stands before a colon does not count.
Landmarks find_landmarks(const BvhClip& clip, std::span<const Naming> namings);

}  // namespace csipose::sim
