// sim/atomic_file.h - a file that is there whole or not at all.
#pragma once

#include <filesystem>
#include <fstream>

#include "proto/bytes.h"

namespace csipose::sim {

/// Writes beside the target under another name and takes the target's name in commit(); without commit()
/// nothing is left.
class AtomicFile {
 public:
  /// Throws SetupError (cannot_create) when the folder does not allow it.
  explicit AtomicFile(std::filesystem::path target);
  ~AtomicFile();
  AtomicFile(const AtomicFile&) = delete;
  AtomicFile& operator=(const AtomicFile&) = delete;

  /// Buffered. Errors show at the latest in commit().
  void write(ByteView bytes);
  /// Throws SetupError (io) when the bytes did not reach the disk.
  void commit();

 private:
  std::filesystem::path target_, part_;
  std::ofstream out_;
  bool committed_ = false;
};

/// Makes `folder` and those above it. Throws SetupError (cannot_create), saying why.
void make_folder(const std::filesystem::path& folder);

}  // namespace csipose::sim
