// Folders of windows: written whole or not at all, over nobody's files, and read as they were written.
#include "train/window_folder_set.h"

#include <unistd.h>

#include "tests/train/numbered_folder.h"
#include "train/window_folder.h"

namespace csipose::train {
namespace {

namespace fs = std::filesystem;
using csipose::testing::say_nothing;
using csipose::testing::write_numbered_folder;

class Folders : public ::testing::Test {
 protected:
  void TearDown() override { fs::remove_all(folder_); }

  fs::path folder_ = fs::temp_directory_path() / fmt::format("csipose-folders-{}", ::getpid());
};

TEST_F(Folders, ComeBackAsTheyWereWritten) {
  write_numbered_folder(folder_ / "set");
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
      say_nothing);
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
  write_numbered_folder(folder_ / "set");
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
