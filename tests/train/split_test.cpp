// Sets in parts: every window is in one, whole clips stay together, the seed says which are drawn.
#include "train/split.h"

#include <unistd.h>

#include <algorithm>
#include <set>

#include "tests/train/made_up_published.h"
#include "tests/train/numbered_folder.h"
#include "train/window_folder.h"
#include "train/window_folder_set.h"

namespace csipose::train {
namespace {

namespace fs = std::filesystem;
using csipose::testing::say_nothing;
using csipose::testing::write_numbered_folder;
using csipose::testing::write_published_split;

class Splits : public ::testing::Test {
 protected:
  void TearDown() override { fs::remove_all(folder_); }

  /// Which windows are in the folder.
  static std::vector<int> windows_in(const fs::path& folder) {
    const auto source = open_window_folder(folder);
    std::vector<float> x(kChannels * kTokens);
    std::vector<int> which;
    for (std::size_t i = 0; i < source->size(); ++i) {
      source->read(i, x);
      EXPECT_EQ(source->people(i).size(), static_cast<std::size_t>(x[0]) % 3);
      EXPECT_EQ(source->clip(i), static_cast<std::uint64_t>(x[0]) / 5);
      which.push_back(static_cast<int>(x[0]));
    }
    return which;
  }
  std::string refusal(const SplitJob& job) const {
    try {
      split(job, say_nothing);
    } catch (const SetupError& error) {
      return error.what();
    }
    return "none";
  }
  /// Drawn and rest are the set; gives those drawn.
  std::vector<int> drawn(const SplitJob& job) const {
    fs::remove_all(job.to);
    const auto parts = split(job, say_nothing);
    EXPECT_EQ(parts.size(), 2u);
    EXPECT_EQ(parts[0].name, "drawn");
    EXPECT_EQ(parts[1].name, "rest");
    std::vector<int> taken = windows_in(job.to / "drawn"), all = windows_in(job.to / "rest");
    EXPECT_EQ(parts[0].windows, taken.size());
    EXPECT_EQ(parts[1].windows, all.size());
    all.insert(all.end(), taken.begin(), taken.end());
    std::ranges::sort(all);
    EXPECT_EQ(all.size(), 100u);
    for (std::size_t i = 0; i < all.size(); ++i) EXPECT_EQ(all[i], static_cast<int>(i));
    return taken;
  }

  fs::path folder_ = fs::temp_directory_path() / fmt::format("csipose-splits-{}", ::getpid());
};

TEST_F(Splits, EachEnvironmentByItself) {
  write_numbered_folder(folder_ / "set");
  const auto parts = split({folder_ / "set", folder_ / "out", SplitBy::environment, 0.1, 0, {}}, say_nothing);
  ASSERT_EQ(parts.size(), 2u);
  EXPECT_EQ(parts[0].name, "hall");
  EXPECT_EQ(parts[1].windows, 50u);
  EXPECT_EQ(windows_in(folder_ / "out/hall").front(), 50);
  EXPECT_EQ(windows_in(folder_ / "out/office").back(), 49);
  EXPECT_EQ(read_rooms(folder_ / "out/hall", 50), std::vector<std::uint8_t>(50, 1));
  EXPECT_NE(refusal({folder_ / "set", folder_ / "out", SplitBy::environment, 0.1, 0, {}})
                .find("holds windows already"),
            std::string::npos);
}

TEST_F(Splits, WholeClipsOfEveryRoom) {
  write_numbered_folder(folder_ / "set");
  const SplitJob job{folder_ / "set", folder_ / "out", SplitBy::clip, 0.2, 7, {}};
  const std::vector<int> taken = drawn(job);
  std::set<int> clips, in_hall;
  for (const int window : taken) clips.insert(window / 5);
  for (const int clip : clips)
    if (clip >= 10) in_hall.insert(clip);
  EXPECT_EQ(taken.size(), 20u);
  EXPECT_EQ(clips.size(), 4u);
  EXPECT_EQ(in_hall.size(), 2u);
  EXPECT_EQ(drawn(job), taken);  // the seed says which
  std::set<std::vector<int>> different;
  for (std::uint64_t seed = 0; seed < 5; ++seed)
    different.insert(drawn({job.from, job.to, job.by, job.share, seed, {}}));
  EXPECT_GT(different.size(), 3u);
}

TEST_F(Splits, SomeWindowsOfEveryClip) {
  write_numbered_folder(folder_ / "set");
  std::map<int, int> of_clip;
  for (const int window : drawn({folder_ / "set", folder_ / "out", SplitBy::window, 0.4, 3, {}}))
    ++of_clip[window / 5];
  EXPECT_EQ(of_clip.size(), 20u);
  for (const auto& [clip, count] : of_clip) EXPECT_EQ(count, 2) << clip;
  EXPECT_EQ(drawn({folder_ / "set", folder_ / "out", SplitBy::window, 0.001, 3, {}}).size(),
            20u);  // at least one
}

TEST_F(Splits, TheEndOfEveryClip) {
  write_numbered_folder(folder_ / "set");
  for (const int window : drawn({folder_ / "set", folder_ / "out", SplitBy::time, 0.4, 3, {}}))
    EXPECT_GE(window % 5, 3) << "the last two of five";
  EXPECT_EQ(drawn({folder_ / "set", folder_ / "out", SplitBy::time, 0.4, 3, {}}).size(), 40u);
  EXPECT_EQ(drawn({folder_ / "set", folder_ / "out", SplitBy::time, 0.001, 3, {}}).size(),
            20u);  // at least one
  EXPECT_EQ(read_about(folder_ / "out/rest").clips, "numbered") << "clips are still known by their numbers";
}

TEST_F(Splits, ByTheListsOfThePublishedSet) {
  write_published_split(folder_ / "root", "train", {"S11_01_10", "S21_01_10"});
  write_published_split(folder_ / "root", "test", {"S11_01_300"});
  const auto parts = split({folder_ / "root", folder_ / "out", SplitBy::lists, 0, 0, {}}, say_nothing);
  ASSERT_EQ(parts.size(), 2u);
  EXPECT_EQ(open_window_folder(folder_ / "out/train")->size(), 2u);
  EXPECT_EQ(open_window_folder(folder_ / "out/test")->clip(0), 1101u);
  EXPECT_EQ(refusal({folder_ / "out/train", folder_ / "x", SplitBy::lists, 0, 0, {}})
                    .find("has no splits of its own") == std::string::npos,
            false);
  EXPECT_NE(
      refusal({folder_ / "root", folder_ / "x", SplitBy::clip, 0.1, 0, {}}).find("is no folder of windows"),
      std::string::npos);
}

TEST_F(Splits, EnvironmentsHaveToBeKnown) {
  {
    WindowFolderWriter writer(folder_ / "set");
    writer.add({std::vector<float>(kChannels * kTokens), 1, {}, {}});
    writer.finish({"recording", false, {}});
  }
  EXPECT_NE(
      refusal({folder_ / "set", folder_ / "out", SplitBy::environment, 0.1, 0, {}}).find("has no room.npy"),
      std::string::npos);
  EXPECT_FALSE(fs::exists(folder_ / "out"));
}

}  // namespace
}  // namespace csipose::train
