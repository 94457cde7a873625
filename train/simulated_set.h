// train/simulated_set.h - a simulated data set (docs/simulator-dataset.md).
//
// Every row of 20 snapshots becomes one window; what was lost is filled across rows of a clip as in a stream. A row
// in which a receiver stays incomplete is left out, and counted. Reads int8 (csi.npy), complex64 and float16 (h.npy) sets.
#pragma once

#include "train/data_set.h"

namespace csipose::train {

///   cost    some 0.2 ms a window, one thread; memory for one window, the labels and the clip numbers
///   throws  SetupError: a set that is not there, not whole or of another kind, an unknown split
std::unique_ptr<const DataSet> open_simulated_set(const std::filesystem::path& folder,
                                                  const std::string& split);
std::vector<std::string> splits_of_simulated_set(const std::filesystem::path& folder);

}  // namespace csipose::train
