// train/window_folder_set.h - a folder of windows (window_folder.h) read as a data set, and how one is written.
#pragma once

#include <vector>

#include "proto/npy.h"
#include "train/data_set.h"

namespace csipose::train {

/// Throws SetupError (no_input, bad_data).
std::unique_ptr<const DataSet> open_window_folder_set(const std::filesystem::path& folder);

/// Writes a folder of windows. windows.npy comes last: without it the folder is no data set, and a new writer takes away
/// what an interrupted one has left.
class WindowFolderWriter {
 public:
  /// For windows of which the first `samples` are kept. Makes the folder where it is not there. Throws SetupError
  /// (cannot_create): it holds windows already, another process is writing it, or it cannot be made.
  explicit WindowFolderWriter(std::filesystem::path folder, std::size_t samples = kSamples);
  /// Throws SetupError (io).
  void add(const LabelledWindow& window);
  /// Throws SetupError (io).
  void finish(const SetAbout& about);
  std::size_t windows() const { return clips_.size(); }

 private:
  void write_labels() const;

  std::filesystem::path folder_;
  std::size_t samples_;
  NpyWriter<float> windows_;
  std::vector<float> kept_;  ///< of the window at hand
  std::vector<std::uint32_t> clips_;
  std::vector<std::uint8_t> rooms_;
  std::vector<std::vector<Skeleton>> people_;
};

}  // namespace csipose::train
