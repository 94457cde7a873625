#include "train/data_set.h"

#include <fmt/format.h>

#include "train/published_set.h"
#include "train/recorded_set.h"
#include "train/refuse.h"
#include "train/simulated_set.h"
#include "train/window_folder_set.h"

namespace csipose::train {
namespace {

namespace fs = std::filesystem;

enum class Form { windows, simulated, published, recording };

Form form_of(const fs::path& from) {
  if (!fs::exists(from)) refuse(from, "is not there", ExitStatus::no_input);
  if (is_recording(from)) return Form::recording;
  if (!fs::is_directory(from)) refuse(from, "is neither a folder nor a recording (.mcap)");
  if (fs::exists(from / "windows.npy")) return Form::windows;
  if (is_published_set(from)) return Form::published;
  for (const char* file : {"dataset.json", "csi.npy", "h.npy"})
    if (fs::exists(from / file)) return Form::simulated;
  refuse(from,
         "is no data set: it has no windows.npy (folder of windows), no dataset.json (simulated set), no "
         "train_data/train_data_list.txt nor another such list (published set), no rx1.dat (logs)");
}

void no_splits(const fs::path& from, const std::string& split) {
  if (!split.empty())
    refuse(from, fmt::format("has no splits; leave out --split {}", split), ExitStatus::usage);
}

}  // namespace

std::string SetAbout::room_name(std::uint8_t room) const {
  const auto name = rooms.find(room);
  return name == rooms.end() ? fmt::format("room{}", room) : name->second;
}

std::unique_ptr<const DataSet> open_data_set(const fs::path& from, const DataSetOptions& options) {
  switch (form_of(from)) {
    case Form::simulated:
      return open_simulated_set(from, options.split);
    case Form::published:
      return open_published_set(from, options);
    case Form::recording:
      no_splits(from, options.split);
      return open_recorded_set(from, options);
    case Form::windows:
      break;
  }
  no_splits(from, options.split);
  return open_window_folder_set(from);
}

std::vector<std::string> splits_of(const fs::path& from) {
  switch (form_of(from)) {
    case Form::simulated:
      return splits_of_simulated_set(from);
    case Form::published:
      return splits_of_published_set(from);
    default:
      return {};
  }
}

}  // namespace csipose::train
