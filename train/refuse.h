// train/refuse.h - a data set's file cannot be used: its name, and why, in one line.
#pragma once

#include <filesystem>
#include <string>

#include "proto/result.h"

namespace csipose::train {

[[noreturn]] inline void refuse(const std::filesystem::path& path, const std::string& why,
                                ExitStatus status = ExitStatus::bad_data) {
  throw SetupError(status, path.string() + ": " + why);
}

}  // namespace csipose::train
