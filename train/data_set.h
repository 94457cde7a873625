// train/data_set.h - a data set of whatever form, as windows one after the other.
//
//   folder of windows   windows.npy ...                         window_folder.h
//   simulated set       dataset.json, csi.npy or h.npy          simulated_set.h
//   published set       train_data/train_data_list.txt ...      published_set.h
//   recording           NAME.mcap, or a folder with rx1.dat rx2.dat rx3.dat (and truth.npy)   recorded_set.h
//
// All but the first make their windows by the daemon's code, so what is trained is what is served.
#pragma once

#include <cstdint>
#include <filesystem>
#include <functional>
#include <map>
#include <memory>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "proto/pose.h"
#include "proto/shape.h"

namespace csipose::train {

/// One window, valid while it is being looked at.
struct LabelledWindow {
  std::span<const float> x;          ///< Window::x, [60][20][9], not normalised
  std::uint32_t clip = 0;            ///< windows of a clip are much alike
  std::optional<std::uint8_t> room;  ///< number of its room
  std::span<const Skeleton> people;  ///< label frame; empty: nobody, or a set without labels
};
using WindowSink = std::function<void(const LabelledWindow&)>;
/// Told what a person should know: one line, without an end.
using Warn = std::function<void(const std::string&)>;

/// What goes with the windows; a folder of windows keeps it in about.json.
struct SetAbout {
  std::string kind;  ///< "simulated", "published", "recording"; "windows": a folder that does not tell
  bool labelled = false;
  std::map<std::uint8_t, std::string> rooms;  ///< names by number, as far as there are names
  std::size_t samples =
      kSamples;  ///< that it keeps of a window; where fewer, each stands for its part of a window
  /// What its clips are numbered in: of sets that say the same, clips of one number are one clip. Empty: not known.
  std::string clips{};

  std::string room_name(std::uint8_t room) const;
};

/// Published clips are numbered as their names say: S23_12_337 is of clip 2312, scene 2.
constexpr std::uint32_t scene_of_clip(std::uint32_t clip) { return clip / 1000; }

/// How many windows of a set were not given, and why not.
struct LeftOut {
  std::size_t incomplete = 0;  ///< a receiver lost too much
  std::size_t unlabelled = 0;  ///< the recording has the truth, but not of this window
  std::size_t broken = 0;      ///< files that cannot be used
};

class DataSet {
 public:
  virtual ~DataSet() = default;
  virtual const SetAbout& about() const = 0;
  /// Gives each window in turn, clip by clip. Throws SetupError that names the file and the reason.
  virtual LeftOut read(const WindowSink& sink, const Warn& warn) const = 0;
};

struct DataSetOptions {
  std::string split;              ///< "train", "test", "train_data" ...; empty = all
  std::filesystem::path env_map;  ///< of a published set: JSON, {"office": ["1"], ...}
  bool skip_broken = false;       ///< of a published set: windows whose files cannot be used are left out
  double grid_hz = 300;           ///< of a recording: samples a second in a window
  int hop = 20;                   ///< of a recording: samples from one window to the next
};

/// Finds out what `from` is and opens it. Throws SetupError: no such thing, or what it lacks.
std::unique_ptr<const DataSet> open_data_set(const std::filesystem::path& from,
                                             const DataSetOptions& options);
/// The splits that it has: of a simulated set those of dataset.json, of a published set "train", "test".
std::vector<std::string> splits_of(const std::filesystem::path& from);

}  // namespace csipose::train
