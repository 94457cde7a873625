// train/mapped_file.h - a file's bytes as they are on the disk, read when they are looked at.
#pragma once

#include <filesystem>

#include "proto/bytes.h"

namespace csipose::train {

class MappedFile {
 public:
  /// Throws SetupError (no_input) that names the file and the reason; an empty file is one.
  explicit MappedFile(const std::filesystem::path& path);
  ~MappedFile();
  MappedFile(const MappedFile&) = delete;
  MappedFile& operator=(const MappedFile&) = delete;
  ByteView bytes() const { return {begin_, size_}; }

 private:
  void* begin_ = nullptr;
  std::size_t size_ = 0;
};

}  // namespace csipose::train
