// proto/mapped_file.h - a file's bytes as they are on the disk, read when they are looked at. C++17-clean.
#pragma once

#include <string>

#include "proto/bytes.h"

namespace csipose {

/// Bytes of a whole file, mapped; they must not change meanwhile.
class MappedFile {
 public:
  /// Throws SetupError when the file cannot be read.
  explicit MappedFile(const std::string& path);
  MappedFile(MappedFile&& other) noexcept;
  MappedFile& operator=(MappedFile&& other) noexcept;
  ~MappedFile();
  ByteView bytes() const { return bytes_; }

 private:
  ByteView bytes_;
};

}  // namespace csipose
