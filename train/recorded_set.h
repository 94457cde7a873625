// train/recorded_set.h - a recording, run through the daemon's front end: one .mcap, or a folder with rx1.dat rx2.dat
// rx3.dat, as csipose-sim record and the daemon write them (docs/recording.md).
//
// Labels are the simulator's truth where there is one: channel /truth of the .mcap, truth.npy (packet, person, joint,
// xyz) beside the .dat files. A window gets the people of the instant of its snapshot 10, as a simulated set does: in an
// .mcap the line whose time is nearest, at most a packet away; in truth.npy the row of the packet that has this slot,
// counted from the first that was heard. A recording is one clip.
#pragma once

#include "train/data_set.h"

namespace csipose::train {

/// True: an .mcap file, or a folder with rx1.dat.
bool is_recording(const std::filesystem::path& from);
/// Throws SetupError: what cannot be read, or makes no window.
std::unique_ptr<const DataSet> open_recorded_set(const std::filesystem::path& from,
                                                 const DataSetOptions& options);

}  // namespace csipose::train
