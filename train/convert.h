// train/convert.h - a data set of any form to a folder of windows (window_folder.h).
#pragma once

#include "train/data_set.h"

namespace csipose::train {

struct ConvertJob {
  std::filesystem::path from, to;
  DataSetOptions options;
  std::string
      installation{};  ///< where all of it was received, in place of its rooms; empty: as the set says
};
struct Converted {
  std::string kind;  ///< of what it was made
  bool labelled = false;
  std::size_t windows = 0;
  LeftOut left_out;
};
/// An interrupted run leaves no windows.npy, and the next one begins anew.
///   throws  SetupError: as open_data_set() and WindowFolderWriter, a set that is a folder of windows already, one of several rooms that is
///           to be of one installation
Converted convert(const ConvertJob& job, const Warn& warn);

}  // namespace csipose::train
