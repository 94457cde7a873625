// tests/train/numbered_folder.h - a folder of windows each of which can be told from the others.
#pragma once

#include <algorithm>
#include <filesystem>
#include <string>
#include <vector>

#include "train/window_folder_set.h"

namespace csipose::testing {

/// For what says how far it is.
inline void say_nothing(const std::string&) {}

/// 2 rooms of 10 clips of 5 windows; window i says i everywhere, and i % 3 people are in it.
inline void write_numbered_folder(const std::filesystem::path& to) {
  train::WindowFolderWriter writer(to);
  std::vector<float> x(kChannels * kTokens);
  for (std::uint32_t i = 0; i < 100; ++i) {
    std::ranges::fill(x, static_cast<float>(i));
    const std::vector<Skeleton> people(i % 3);
    writer.add({x, i / 5, static_cast<std::uint8_t>(i / 50), people});
  }
  writer.finish(
      {"simulated", true, {{0, "office"}, {1, "hall"}, {2, "nobody was here"}}, kSamples, "numbered"});
}

}  // namespace csipose::testing
