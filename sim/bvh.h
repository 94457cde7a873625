// sim/bvh.h - motion capture files of the BVH kind: a tree of joints, then one line of numbers per frame.
//
// Format: Biovision Hierarchy, as described by Meredith and Maddock, "Motion Capture File Formats Explained", University of
// Sheffield CS-01-11 (2001). Units of length and the axis that points up are not part of it. What this reader takes:
// docs/simulator-motion.md.
#pragma once

#include <array>
#include <filesystem>
#include <glm/gtc/quaternion.hpp>
#include <string>
#include <string_view>
#include <vector>

#include "sim/geometry.h"

namespace csipose::sim {

/// A file as it is: its own units, axes and names.
struct BvhClip {
  /// Positions, then rotations, each along x, y, z.
  using Channel = std::uint8_t;
  static constexpr Channel kFirstRotation = 3, kChannelKinds = 6;

  struct Joint {
    std::string name;  ///< empty = end site
    int parent = -1;   ///< comes before it in the list; -1 = root
    Vec3 offset{};     ///< from the parent, in the parent's axes
    std::vector<Channel> channels;
    std::size_t first_value = 0;  ///< of its channels in a frame
    std::size_t line = 0;         ///< of the file, for messages
  };

  std::string file_name;
  std::vector<Joint> joints;
  std::size_t channels = 0;    ///< of all joints together
  std::vector<double> values;  ///< [frame][channel]; degrees and units of length
  double frame_s = 0;

  std::size_t frames() const { return channels == 0 ? 0 : values.size() / channels; }
  /// Of a joint in its parent's axes: the channels where it has such, else the offset.
  Vec3 position(std::size_t frame, std::size_t joint) const;
  /// Turns in the order of the channels, each about an axis that the earlier ones have turned.
  glm::dquat rotation(std::size_t frame, std::size_t joint) const;
};

inline constexpr std::size_t kMostBvhJoints = 512;
inline constexpr double kMostBvhNumber = 1e6;

/// Throws SetupError (bad_data) that names file and line and what would be right.
///   cost  memory in proportion to the text, whatever counts it states
BvhClip parse_bvh(std::string_view text, const std::string& file_name);
/// The same from a file; SetupError (no_input) when it cannot be read.
BvhClip read_bvh(const std::filesystem::path& file);

}  // namespace csipose::sim
