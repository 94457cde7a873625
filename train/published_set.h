// train/published_set.h - the published data set (Person-in-WiFi 3D) as it is on disk; published_files.h has its files.
//
// Windows come clip by clip and frame by frame, whatever the order of the lists. room is the environment.
#pragma once

#include "train/data_set.h"

namespace csipose::train {

/// True: `root` has a list of names where the published set has it.
bool is_published_set(const std::filesystem::path& root);

///   cost    some 0.6 ms a window; memory for the names
///   throws  SetupError; with options.skip_broken, files that cannot be used are told to `warn` instead, and counted
std::unique_ptr<const DataSet> open_published_set(const std::filesystem::path& root,
                                                  const DataSetOptions& options);
/// Those with a list: "train", "test".
std::vector<std::string> splits_of_published_set(const std::filesystem::path& root);

}  // namespace csipose::train
