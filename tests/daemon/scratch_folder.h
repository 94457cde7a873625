// tests/daemon/scratch_folder.h - a folder of one test's own, gone with it. Short, because socket paths must
// be.
#pragma once

#include <gtest/gtest.h>
#include <stdlib.h>

#include <filesystem>
#include <string>

namespace csipose::testing {

class ScratchFolder {
 public:
  ScratchFolder() {
    std::string path = (std::filesystem::temp_directory_path() / "csipose.XXXXXX").string();
    if (mkdtemp(path.data()) == nullptr) ADD_FAILURE() << "no folder can be made at " << path;
    path_ = path;
  }
  ~ScratchFolder() {
    std::error_code error;
    std::filesystem::remove_all(path_, error);
  }
  ScratchFolder(const ScratchFolder&) = delete;
  ScratchFolder& operator=(const ScratchFolder&) = delete;

  std::string operator/(const std::string& name) const { return (path_ / name).string(); }

 private:
  std::filesystem::path path_;
};

}  // namespace csipose::testing
