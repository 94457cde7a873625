#include "train/convert.h"

#include <set>

#include "train/refuse.h"
#include "train/window_folder_set.h"

namespace csipose::train {

Converted convert(const ConvertJob& job, const Warn& warn) {
  const auto set = open_data_set(job.from, job.options);
  if (std::filesystem::exists(job.from / "windows.npy"))
    refuse(job.from, "is a folder of windows already", ExitStatus::usage);
  if (job.installation.find('/') != std::string::npos)
    refuse(job.installation, "is no name of an installation: it holds a slash", ExitStatus::usage);
  WindowFolderWriter writer(job.to, set->about().samples);
  std::set<std::uint8_t> rooms;
  const LeftOut left_out = set->read(
      [&](LabelledWindow window) {
        if (!job.installation.empty()) {
          if (rooms.insert(window.room.value_or(0)).second && rooms.size() > 1)
            refuse(job.from, "has windows of several rooms, which cannot be one installation",
                   ExitStatus::usage);
          window.room = 0;
        }
        writer.add(window);
      },
      warn);
  SetAbout about = set->about();
  if (!job.installation.empty()) about.rooms = {{0, job.installation}};
  writer.finish(about);
  return {set->about().kind, set->about().labelled, writer.windows(), left_out};
}

}  // namespace csipose::train
