// train/window_folder.h - a folder of finished windows, the form in which training reads data sets fastest.
//
//   windows.npy   float32 (n, 60, T, 9): the first T samples of Window::x of each window, not normalised. T is 20, less only
//                 where the set has fewer snapshots of a scene; each then stands for its T-th part of the window
//   clip.npy      uint32 (n): windows of one clip are held out together
//   labels.npy    float32 (n, P, 14, 3), where there are labels: joints of up to P people in metres in the label frame;
//                 not a number where nobody is
//   room.npy      uint8 (n), where the rooms are known
//   about.json    what the set was made from, the rooms' names; may be missing
//
// The windows are mapped, not loaded: the set may be larger than memory.
#pragma once

#include <filesystem>
#include <memory>
#include <vector>

#include "train/data_set.h"
#include "train/window_source.h"

namespace csipose::train {

/// Throws SetupError (no_input, bad_data) that names file and reason.
std::shared_ptr<const WindowSource> open_window_folder(const std::filesystem::path& folder);
/// room.npy, one number a window; empty where there is none. Throws SetupError (bad_data).
std::vector<std::uint8_t> read_rooms(const std::filesystem::path& folder, std::size_t windows);
/// about.json; of kind "windows" where there is none. Throws SetupError (bad_data).
SetAbout read_about(const std::filesystem::path& folder);

}  // namespace csipose::train
