#include "train/convert.h"

#include "train/refuse.h"
#include "train/window_folder_set.h"

namespace csipose::train {

Converted convert(const ConvertJob& job, const Warn& warn) {
  const auto set = open_data_set(job.from, job.options);
  if (std::filesystem::exists(job.from / "windows.npy"))
    refuse(job.from, "is a folder of windows already", ExitStatus::usage);
  WindowFolderWriter writer(job.to, set->about().samples);
  const LeftOut left_out = set->read([&](const LabelledWindow& window) { writer.add(window); }, warn);
  writer.finish(set->about());
  return {set->about().kind, set->about().labelled, writer.windows(), left_out};
}

}  // namespace csipose::train
