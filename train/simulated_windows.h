// train/simulated_windows.h - a simulated data set (docs/simulator-dataset.md) to a folder of finished windows
// (window_folder.h).
//
// Every row of 20 snapshots becomes one window by the daemon's own code: capture/features.h makes the numbers
// of a snapshot, capture/window_builder.h fills what was lost from at most FrontEndConfig::max_gap snapshots
// before, across rows of a clip as in a stream. A row in which a receiver stays incomplete is left out, and
// counted.
#pragma once

#include <cstddef>
#include <filesystem>
#include <string>

namespace csipose::train {

struct ConvertJob {
  std::filesystem::path from, to;
  std::string split;  ///< "train", "val", "test" as the set's dataset.json lists clips; empty = all
};
struct Converted {
  std::size_t windows = 0;
  std::size_t incomplete = 0;  ///< rows left out
};

/// Writes windows.npy, clip.npy, and labels.npy and room.npy where the set has them. windows.npy comes last:
/// without it the folder is no data set. Reads int8 (csi.npy) and complex64 (h.npy) sets.
///   cost    some 0.2 ms a window, one thread; memory for one window, the labels and the clip numbers
///   throws  SetupError: a set that is not there, not whole or of another kind, an unknown split, a target
///           that holds windows already
Converted convert_simulated(const ConvertJob& job);

}  // namespace csipose::train
