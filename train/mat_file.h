// train/mat_file.h - a window of the published data set: channel state in a MATLAB v7.3 file, which is HDF5.
//
//   csi_out   compound {real, imag} of float64 or float32, HDF5 shape (20, 30, 3, 3): packet, subcarrier, antenna, receiver
//
// The members count by their names; any layout that the library reads is read (user block, chunks, deflate).
// source: aiotgroup/Person-in-WiFi-3D-repo (its loader).
#pragma once

#include <filesystem>
#include <vector>

#include "capture/sanitise.h"

namespace csipose::train {

/// [t * 3 + receiver]. Throws SetupError (no_input, bad_data) of one line that names the file and the reason.
///   cost  less than 0.5 ms; from one thread at a time
std::vector<StreamCsi> read_mat(const std::filesystem::path& path);

}  // namespace csipose::train
