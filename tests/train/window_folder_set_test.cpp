// Folders of windows: written whole or not at all, over nobody's files, and read as they were written.
#include "train/window_folder_set.h"

#include <unistd.h>

#include "train/window_folder.h"

namespace csipose::train {
namespace {

namespace fs = std::filesystem;

void ignore(const std::string&) {}

class Folders : public ::testing::Test {
 protected:
  void TearDown() override { fs::remove_all(folder_); }

  /// 2 rooms of 10 clips of 5 windows; window i says i everywhere.
  void write_set(const fs::path& to) const {
    WindowFolderWriter writer(to);
    std::vector<float> x(kChannels * kTokens);
    for (std::uint32_t i = 0; i < 100; ++i) {
      std::ranges::fill(x, static_cast<float>(i));
      const std::vector<Skeleton> people(i % 3);
      writer.add({x, i / 5, static_cast<std::uint8_t>(i / 50), people});
    }
    writer.finish({"simulated", true, {{0, "office"}, {1, "hall"}, {2, "nobody was here"}}});
  }

  fs::path folder_ = fs::temp_directory_path() / fmt::format("csipose-folders-{}", ::getpid());
};

TEST_F(Folders, ComeBackAsTheyWereWritten) {
  write_set(folder_ / "set");
  const auto set = open_data_set(folder_ / "set", {});
  EXPECT_EQ(set->about().kind, "simulated");
  EXPECT_TRUE(set->about().labelled);
  EXPECT_EQ(set->about().rooms, (std::map<std::uint8_t, std::string>{{0, "office"}, {1, "hall"}}));
  std::uint32_t i = 0;
  set->read(
      [&](const LabelledWindow& window) {
        EXPECT_EQ(window.x[77], static_cast<float>(i));
        EXPECT_EQ(window.clip, i / 5);
        EXPECT_EQ(window.room, i / 50);
        EXPECT_EQ(window.people.size(), i % 3);
        ++i;
      },
      ignore);
  EXPECT_EQ(i, 100u);
}

TEST_F(Folders, BeginAnewAfterAnInterruption) {
  const fs::path set = folder_ / "set";
  fs::create_directories(set);
  std::ofstream(set / "labels.npy") << "of an interrupted run";
  std::ofstream(set / "windows.npy.part999999999") << "likewise";  // no process has this number
  {
    WindowFolderWriter interrupted(set);
    EXPECT_FALSE(fs::exists(set / "labels.npy"));
    interrupted.add({std::vector<float>(kChannels * kTokens), 1, {}, {}});
  }
  EXPECT_TRUE(fs::is_empty(set));
  WindowFolderWriter writer(set);
  writer.add({std::vector<float>(kChannels * kTokens), 1, {}, {}});
  writer.finish({"recording", false, {}});
  EXPECT_FALSE(fs::exists(set / "labels.npy"));
  EXPECT_FALSE(fs::exists(set / "room.npy"));
  EXPECT_EQ(open_window_folder(set)->size(), 1u);
}

TEST_F(Folders, NobodysFilesAreWrittenOver) {
  const auto refusal_of = [](const fs::path& path) {
    try {
      WindowFolderWriter writer(path);
    } catch (const SetupError& error) {
      return std::string(error.what());
    }
    return std::string("none");
  };
  write_set(folder_ / "set");
  EXPECT_NE(refusal_of(folder_ / "set").find("holds windows already"), std::string::npos);
  fs::create_directories(folder_ / "other");
  std::ofstream(folder_ / "other/clip.npy") << "of a simulated set";
  std::ofstream(folder_ / "other/csi.npy") << "of a simulated set";
  EXPECT_NE(refusal_of(folder_ / "other").find("holds csi.npy, which is of something else"),
            std::string::npos);
  EXPECT_TRUE(fs::exists(folder_ / "other/clip.npy"));
  std::ofstream(folder_ / "file") << "x";
  EXPECT_NE(refusal_of(folder_ / "file").find("cannot be made"), std::string::npos);
  WindowFolderWriter first(folder_ / "busy");
  EXPECT_NE(refusal_of(folder_ / "busy").find(fmt::format("process {} is writing there", ::getpid())),
            std::string::npos);
}

}  // namespace
}  // namespace csipose::train
