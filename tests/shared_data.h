// tests/shared_data.h - the folder with other people's recordings and golden values.
//
// CMake's CSIPOSE_SHARED_DATA names it. Not given: a test that needs it says that it was left out. Given: a
// missing file is a failure.
#pragma once

#include <gtest/gtest.h>

#include <filesystem>
#include <string>

namespace csipose::testing {
inline bool have_shared_data() { return std::string(CSIPOSE_SHARED_DATA).size() > 0; }
inline std::filesystem::path shared_data(const std::string& relative) {
  const auto path = std::filesystem::path(CSIPOSE_SHARED_DATA) / relative;
  if (!std::filesystem::exists(path)) ADD_FAILURE() << "missing in the shared data: " << path;
  return path;
}
}  // namespace csipose::testing

/// First line of a test that reads shared data.
#define CSIPOSE_NEEDS_SHARED_DATA()          \
  if (!csipose::testing::have_shared_data()) \
  GTEST_SKIP() << "left out: configure with -DCSIPOSE_SHARED_DATA=FOLDER to compare with the golden values"
