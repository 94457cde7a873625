// train/split.h - a data set in parts, each a folder of windows.
#pragma once

#include "train/data_set.h"

namespace csipose::train {

enum class SplitBy {
  lists,        ///< the set's own splits, each to a folder: "train", "test" ...
  environment,  ///< a folder of each room's name
  clip,         ///< whole clips: "drawn" and "rest"
  window,       ///< windows of every clip: "drawn" and "rest"
  time,         ///< the last windows of every clip: "drawn"; "rest" are those before
};
struct SplitJob {
  std::filesystem::path from, to;  ///< from: a folder of windows; by lists, a published or simulated set
  SplitBy by = SplitBy::clip;
  double share = 0.1;      ///< that is drawn; of each room's clips, or of each clip's windows; at least one
  std::uint64_t seed = 0;  ///< which; not by time
  DataSetOptions options;  ///< by lists
};
struct SplitPart {
  std::string name;
  std::size_t windows = 0;
};
/// Every window goes into one part. Folders become whole at the end, one right after the other.
///   throws  SetupError
std::vector<SplitPart> split(const SplitJob& job, const Warn& warn);

}  // namespace csipose::train
