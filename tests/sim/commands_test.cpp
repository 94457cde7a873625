// csipose-sim as a person runs it: exit status, words, files.
#include <gtest/gtest.h>
#include <sys/wait.h>

#include <algorithm>
#include <array>
#include <complex>
#include <cstdio>
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <string>

#include "bvh_text.h"
#include "proto/npy.h"
#include "proto/recording.h"
#include "tests/file_bytes.h"

namespace csipose::sim {
namespace {
namespace fs = std::filesystem;
using csipose::testing::file_bytes;

struct Outcome {
  int status;
  std::string words;
};
Outcome run(const std::string& arguments) {
  const std::string command = std::string(CSIPOSE_BIN_DIR) + "/csipose-sim " + arguments + " 2>&1";
  FILE* pipe = popen(command.c_str(), "r");
  Outcome outcome{-1, {}};
  std::array<char, 512> buffer;
  while (const std::size_t got = std::fread(buffer.data(), 1, buffer.size(), pipe))
    outcome.words.append(buffer.data(), got);
  outcome.status = WEXITSTATUS(pclose(pipe));
  return outcome;
}

class Commands : public ::testing::Test {
 protected:
  void SetUp() override {
    std::string pattern = (fs::temp_directory_path() / "csipose-sim-XXXXXX").string();
    ASSERT_NE(mkdtemp(pattern.data()), nullptr);
    folder_ = pattern;
  }
  void TearDown() override { fs::remove_all(folder_); }
  fs::path folder_;
};

TEST_F(Commands, WritesThreeLogsTheSameForTheSameSeed) {
  ASSERT_EQ(run("record --seconds 0.5 --out " + (folder_ / "a").string()).status, 0);
  ASSERT_EQ(run("record --seconds 0.5 --out " + (folder_ / "b").string()).status, 0);
  ASSERT_EQ(run("record --seconds 0.5 --seed 2 --out " + (folder_ / "c").string()).status, 0);
  for (const char* name : {"rx1.dat", "rx2.dat", "rx3.dat"}) {
    EXPECT_GT(file_bytes(folder_ / "a" / name).size(), 100 * 215u);
    EXPECT_EQ(file_bytes(folder_ / "a" / name), file_bytes(folder_ / "b" / name));
    EXPECT_NE(file_bytes(folder_ / "a" / name), file_bytes(folder_ / "c" / name));
  }
  EXPECT_EQ(read_npy<float>(folder_ / "a" / "truth.npy").shape, (NpyShape{150, 1, 14, 3}));
  EXPECT_EQ(std::distance(fs::directory_iterator(folder_ / "a"), {}), 4) << "nothing else is left";
}

TEST_F(Commands, RefusesWithWordsAndAStatus) {
  const Outcome unknown = run("record --scene palace --out " + folder_.string());
  EXPECT_EQ(unknown.status, 66);
  EXPECT_NE(unknown.words.find("no room 'palace'; there are office, classroom, corridor, empty"),
            std::string::npos);
  EXPECT_EQ(run("record").status, 64);
  EXPECT_EQ(run("record --seconds -1 --out " + folder_.string()).status, 64);
  EXPECT_EQ(run("record --impair heavy --out " + folder_.string()).status, 64);
  EXPECT_EQ(run("").status, 64);

  std::ofstream(folder_ / "file") << "x";
  const Outcome blocked = run("record --seconds 0.1 --out " + (folder_ / "file" / "below").string());
  EXPECT_EQ(blocked.status, 73);
  EXPECT_NE(blocked.words.find("file/below"), std::string::npos);
}

TEST_F(Commands, PlaysMotionCaptureFiles) {
  const std::string file = (folder_ / "walk.bvh").string(), out = " --out " + (folder_ / "a").string();
  std::ofstream(file) << BvhWriter()({{}, {{"Hips.Zposition", 50}}}, 0.5);
  const std::string play = "record --scene empty --bvh " + file;
  ASSERT_EQ(run(play + " --bvh " + file + " --seconds 0.2" + out).status, 0);
  const auto truth = read_npy<float>(folder_ / "a" / "truth.npy");
  EXPECT_EQ(truth.shape, (NpyShape{60, 2, 14, 3}));
  const std::size_t last = truth.data.size() - 2 * 14 * 3;
  EXPECT_NEAR(truth.data[last] - truth.data[0], 0.5 * 59 / 150, 1e-4) << "one metre a second along x";

  const Outcome giant = run(play + " --bvh-unit 1" + out);
  EXPECT_EQ(giant.status, 65);
  EXPECT_NE(giant.words.find("m tall at 1 m per unit"), std::string::npos) << giant.words;
  EXPECT_EQ(run("record --scene empty --bvh " + file + ".gone" + out).status, 66);
  EXPECT_EQ(run("record --scene reflector --bvh " + file + out).status, 64);
  EXPECT_EQ(run("record --scene empty --bvh-unit 1" + out).status, 64);
}

TEST_F(Commands, AHumanDataSetIsTheSameHoweverOftenItWasInterrupted) {
  const std::string common = "dataset human --clips 3 --frames 2 --room office --actions walk,wave --out ";
  const fs::path whole = folder_ / "whole", stopped = folder_ / "stopped";
  ASSERT_EQ(run(common + whole.string() + " --threads 2").status, 0);
  for (int i = 0; i < 4 && !fs::exists(stopped / "dataset.json"); ++i)
    run("dataset human --clips 3 --frames 2 --room office --actions walk,wave --threads 1 --out " +
        stopped.string() + " & sleep 0.3; kill -9 $!; wait $!");
  ASSERT_EQ(run(common + stopped.string()).status, 0);
  for (const auto& entry : fs::directory_iterator(whole))
    EXPECT_EQ(file_bytes(entry.path()), file_bytes(stopped / entry.path().filename())) << entry.path();
  const auto labels = read_npy<float>(whole / "labels.npy");
  EXPECT_EQ(labels.shape, (NpyShape{6, 3, 14, 3}));
  EXPECT_EQ(run("dataset human --room nowhere.json --out " + (folder_ / "x").string()).status, 66);
  EXPECT_EQ(run("dataset human --least-people 3 --most-people 1 --out " + (folder_ / "x").string()).status,
            64);
  EXPECT_EQ(run(common + whole.string() + " --seed 2").status, 65) << "another set lies there";
}

TEST_F(Commands, ARecordingHasTheBytesOfTheLogsAndTheTruth) {
  const std::string scene = "record --seconds 0.2 --people 2 --out ";
  ASSERT_EQ(run(scene + (folder_ / "logs").string()).status, 0);
  ASSERT_EQ(run(scene + (folder_ / "a.mcap").string()).status, 0);
  ASSERT_EQ(run(scene + (folder_ / "b.mcap").string()).status, 0);
  EXPECT_EQ(file_bytes(folder_ / "a.mcap"), file_bytes(folder_ / "b.mcap")) << "its clock begins at 0";
  EXPECT_FALSE(fs::exists(folder_ / "a.mcap.part"));
  const std::string file = file_bytes(folder_ / "a.mcap");
  RecordingReader reader(file, "a.mcap");
  std::array<std::string, kReceivers> logs;
  Packet packet;
  PoseItem pose;
  while (reader.next(packet, pose) == RecordingReader::Item::packet)
    logs[packet.receiver].append(reinterpret_cast<const char*>(packet.records.data()), packet.records.size());
  for (std::size_t r = 0; r < kReceivers; ++r)
    EXPECT_EQ(logs[r], file_bytes(folder_ / "logs" / ("rx" + std::to_string(r + 1) + ".dat")));
  EXPECT_EQ(reader.info().source, Source::simulated);
  EXPECT_EQ(reader.stats().foreign, 0u) << "the truth is known";
}

TEST_F(Commands, SolveWritesTheChannelAndEveryPath) {
  std::ofstream(folder_ / "s.json")
      << R"({"tx": [0, 0, 1], "rx": [{"center": [3, 0, 1]}], "antennas": 1, "snapshots": 2,
    "pattern": "iso", "subcarriers": [0], "bodies": [{"kind": "sphere", "c": [1, 2, 1], "r": 0.3, "mat": "metal"}]})";
  const fs::path h = folder_ / "h.npy", paths = folder_ / "p.jsonl";
  const Outcome done =
      run("solve " + (folder_ / "s.json").string() + " --out " + h.string() + " --paths " + paths.string());
  ASSERT_EQ(done.status, 0) << done.words;
  EXPECT_EQ(read_npy<std::complex<float>>(h).shape, (NpyShape{2, 1, 1, 1}));
  ASSERT_EQ(run("solve --reference " + (folder_ / "s.json").string() + " --out " + h.string()).status, 0);
  EXPECT_EQ(read_npy<std::complex<double>>(h).shape, (NpyShape{2, 1, 1, 1}));
  const std::string lines = file_bytes(paths);
  EXPECT_EQ(std::count(lines.begin(), lines.end(), '\n'), 4);  // two snapshots: direct, and by the ball
  EXPECT_NE(lines.find(R"("type":"body","body":0,"pair":[-1,-1],"face":null)"), std::string::npos) << lines;
  EXPECT_EQ(run("solve " + (folder_ / "none.json").string() + " --out " + h.string()).status, 66);
}

TEST_F(Commands, SaysSoWhenTheDiskIsFull) {
  if (!fs::exists("/dev/full")) GTEST_SKIP() << "no /dev/full here";
  fs::create_directories(folder_ / "full");
  fs::create_symlink("/dev/full", folder_ / "full" / "rx1.dat.part");
  const Outcome full = run("record --seconds 1 --out " + (folder_ / "full").string());
  EXPECT_EQ(full.status, 74);
  EXPECT_NE(full.words.find("rx1.dat"), std::string::npos);
  EXPECT_FALSE(fs::exists(folder_ / "full" / "rx2.dat"));
}

TEST_F(Commands, RendersAPictureOrAFilm) {
  const std::string small = "render --scene office --width 320 --height 180 --past 0.1 --at 0.1 --out ";
  ASSERT_EQ(run(small + (folder_ / "a.png").string()).status, 0);
  EXPECT_EQ(file_bytes(folder_ / "a.png").substr(1, 3), "PNG");
  const Outcome film = run(small + (folder_ / "c.mp4").string() + " --seconds 0.05 --fps 20");
  ASSERT_EQ(film.status, 0) << film.words;
  EXPECT_NE(film.words.find("1 pictures"), std::string::npos);
  EXPECT_EQ(file_bytes(folder_ / "c.mp4").substr(4, 4), "ftyp");
  EXPECT_EQ(std::distance(fs::directory_iterator(folder_), {}), 2) << "nothing half-written is left";
}

TEST_F(Commands, SolvesBodiesAsTrianglesAndSaysWhenItMust) {
  const auto scene = [&](const char* name, const std::string& body) {
    std::ofstream(folder_ / name)
        << R"({"tx": [0, 0, 1], "antennas": 1, "snapshots": 1, "rx": [{"center": [3, 0, 1]}], "bodies": [)"
        << body << "]}";
    return "solve " + (folder_ / name).string() + " --out " + (folder_ / "h.npy").string();
  };
  const std::string ball =
      scene("ball.json", R"({"kind": "sphere", "c": [1.5, 1, 1], "r": 0.2, "mat": "wood"})");
  EXPECT_EQ(run(ball + " --scatter po").status, 0);
  EXPECT_EQ(run(ball + " --scatter facet").status, 0);
  EXPECT_EQ(run(ball + " --scatter soft").status, 64);
  std::ofstream(folder_ / "t.obj")
      << "v 0 0 0\nv .3 0 0\nv 0 .3 0\nv 0 0 .3\nf 1 3 2\nf 1 2 4\nf 2 3 4\nf 3 1 4\n";
  const std::string mesh =
      scene("mesh.json", R"({"kind": "mesh", "file": "t.obj", "c": [1.5, 1, 1], "mat": "wood"})");
  const Outcome refused = run(mesh);
  EXPECT_EQ(refused.status, 64);
  EXPECT_NE(refused.words.find("add --scatter po"), std::string::npos) << refused.words;
  EXPECT_EQ(run(mesh + " --scatter po").status, 0);
}

TEST_F(Commands, RenderRefusesInWords) {
  const Outcome gif = run("render --out " + (folder_ / "a.gif").string());
  EXPECT_EQ(gif.status, 64);
  EXPECT_NE(gif.words.find("neither a picture (.png) nor a film (.mp4)"), std::string::npos) << gif.words;
  EXPECT_NE(run("render --scene reflector --out " + (folder_ / "a.png").string()).words.find("formula"),
            std::string::npos);
  EXPECT_EQ(run("render --width 320 --height 180 --at 0 --out " + (folder_ / "no" / "a.png").string()).status,
            73);
  EXPECT_EQ(run("render --width 320 --height 180 --at 0 --out " + (folder_ / "no" / "a.mp4").string()).status,
            73);
}

}  // namespace
}  // namespace csipose::sim
