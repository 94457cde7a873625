// train/published_files.h - the small files of the published data set (Person-in-WiFi 3D): lists, names, labels, rooms.
//
//   <root>/train_data/train_data_list.txt   one name a line; what follows a blank is not looked at, and the first empty
//                                           line ends the list, as in the set's own reader
//   <root>/train_data/csi/<name>.mat        mat_file.h
//   <root>/train_data/keypoint/<name>.npy   float64 or float32 (people, 14, 3), metres; (14, 3) is one person
//
//   S23_12_337: scene 2, three people, clip 12, frame 337 of a video of 15 a second. What the scene's digit means is
//   not published; which environment it is has to be told.
// source: aiotgroup/Person-in-WiFi-3D-repo (names, list, label shape).
#pragma once

#include <cstdint>
#include <map>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "proto/bytes.h"
#include "proto/pose.h"
#include "proto/result.h"

namespace csipose::train {

struct WindowName {
  std::string text;
  std::uint32_t scene = 0, people = 0, clip = 0;  ///< one digit, one digit, two digits
  std::uint32_t frame = 0;

  /// One number for (scene, people, clip): S23_12 is 2312.
  std::uint32_t clip_number() const { return scene * 1000 + people * 100 + clip; }
};
/// nullopt: no such name. What is a name holds no character that means something in a path.
std::optional<WindowName> parse_window_name(std::string_view text);

struct NameList {
  std::vector<WindowName> names;
  std::size_t after_end = 0;  ///< lines that hold something after the empty line
};
/// Error: the line and what is wrong with it.
Result<NameList, std::string> parse_name_list(std::string_view text);

/// Error: what is wrong with the file.
Result<std::vector<Skeleton>, std::string> parse_keypoints(ByteView file);

/// Which environment a scene's digit is: {"office": ["1"], "classroom": ["2", "5"]}, numbered in this order.
class EnvironmentMap {
 public:
  /// Without a map each digit is its own environment, numbered by itself.
  EnvironmentMap() = default;
  static Result<EnvironmentMap, std::string> parse(std::string_view json);

  /// nullopt: the map says nothing of this scene.
  std::optional<std::uint8_t> of_scene(std::uint32_t scene) const;
  /// All of the map; without a map "scene0" ... "scene9".
  const std::map<std::uint8_t, std::string>& names() const { return names_; }

 private:
  std::map<std::uint32_t, std::uint8_t> of_scene_;
  std::map<std::uint8_t, std::string> names_ = scenes();
  static std::map<std::uint8_t, std::string> scenes();
};

}  // namespace csipose::train
