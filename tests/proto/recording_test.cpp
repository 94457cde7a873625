#include "proto/recording.h"

#include <gtest/gtest.h>
#include <sys/stat.h>

#include <algorithm>
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <iterator>

#include "proto/result.h"

namespace csipose {
namespace {

namespace fs = std::filesystem;
using Bytes = std::vector<std::uint8_t>;
using namespace std::chrono_literals;

constexpr std::int64_t kUtc_ns = 1'790'000'000'000'000'000;

class RecordingTest : public ::testing::Test {
 protected:
  RecordingTest() {
    std::string pattern = ::testing::TempDir() + "csipose-recording-XXXXXX";
    folder_ = mkdtemp(pattern.data());
    config_.folder = folder_ + "/recordings";
    config_.info = {Source::simulated, {"door", "window", "desk"}, "test"};
    config_.pose_schema = "a schema";
  }
  ~RecordingTest() override { fs::remove_all(folder_); }

  std::vector<std::string> files() const {
    std::vector<std::string> names;
    for (const auto& entry : fs::directory_iterator(config_.folder)) names.push_back(entry.path().string());
    std::sort(names.begin(), names.end());
    return names;
  }
  static Bytes bytes_of(const std::string& path) {
    std::ifstream file(path, std::ios::binary);
    return {std::istreambuf_iterator<char>(file), {}};
  }
  static std::size_t packets_in(const std::string& path) {
    const Bytes bytes = bytes_of(path);
    RecordingReader reader(bytes, path);
    Packet packet;
    PoseItem pose;
    std::size_t count = 0;
    while (reader.next(packet, pose) != RecordingReader::Item::end) ++count;
    return count;
  }
  Packet packet(std::int64_t n) {
    return {static_cast<std::uint8_t>(n % 3), SteadyTime(Nanoseconds(1000 * n)),
            UtcTime(Nanoseconds(kUtc_ns + 1000 * n)), records_};
  }

  std::string folder_;
  RecorderConfig config_;
  Bytes records_ = {0, 2, 0xBB, 7};
};

TEST_F(RecordingTest, SteadyTimeSurvivesExactlyThoughUtcSteps) {
  const std::string path = folder_ + "/a.mcap";
  const std::vector<std::int64_t> steady = {987'654'321, 987'654'322, 5'000'000'000'003, 4'999'999'999'999};
  const std::vector<std::int64_t> utc = {kUtc_ns, kUtc_ns - 3'600'000'000'000, kUtc_ns + 7, 1};
  {
    RecordingWriter writer(path, config_.info, config_.pose_schema);
    for (std::size_t i = 0; i < steady.size(); ++i)
      writer.add(Packet{static_cast<std::uint8_t>(i % 3), SteadyTime(Nanoseconds(steady[i])),
                        UtcTime(Nanoseconds(utc[i])), records_});
    writer.add(PoseItem{Bytes{9, 9}, 42, SteadyTime(Nanoseconds(17)), UtcTime(Nanoseconds(kUtc_ns))});
  }
  const Bytes bytes = bytes_of(path);
  RecordingReader reader(bytes, path);
  Packet packet;
  PoseItem pose;
  for (std::size_t i = 0; i < steady.size(); ++i) {
    ASSERT_EQ(reader.next(packet, pose), RecordingReader::Item::packet);
    EXPECT_EQ(packet.receiver, i % 3);
    EXPECT_EQ(ns(packet.arrival), steady[i]);
    EXPECT_EQ(ns(packet.arrival_utc), utc[i]);
    EXPECT_EQ(Bytes(packet.records.begin(), packet.records.end()), records_);
  }
  ASSERT_EQ(reader.next(packet, pose), RecordingReader::Item::pose);
  EXPECT_EQ(pose.seq, 42u);
  EXPECT_EQ(ns(pose.published), 17);
  EXPECT_EQ(reader.next(packet, pose), RecordingReader::Item::end);
  EXPECT_EQ(reader.info().source, Source::simulated);
  EXPECT_EQ(reader.info().receivers[2], "desk");
  EXPECT_TRUE(reader.has_poses());
  EXPECT_TRUE(reader.stats().mcap.complete);
}

TEST_F(RecordingTest, ForeignFilesAreRefusedAndForeignChannelsPassedOver) {
  const Bytes text(100, 'x');
  EXPECT_THROW(RecordingReader(text, "x.mcap"), SetupError);
  const std::string path = folder_ + "/a.mcap";
  {
    McapWriter writer(path, "somebody else");
    writer.add_channel("/camera", 0, "json", {{"receiver", "1"}});
    writer.add_channel("/csi/far", 0, "csipose-records", {{"receiver", "17"}});
    writer.write({1, 0, 0, 0, Bytes{1}});
    writer.write({2, 0, 0, 0, Bytes{1}});
  }
  const Bytes bytes = bytes_of(path);
  RecordingReader reader(bytes, path);
  Packet packet;
  PoseItem pose;
  EXPECT_EQ(reader.next(packet, pose), RecordingReader::Item::end);
  EXPECT_EQ(reader.stats().foreign, 2u);
}

TEST_F(RecordingTest, NothingIsOlderThanASecondOnTheDisk) {
  Recorder recorder(config_);
  SteadyTime now{100s};
  std::size_t sent = 0;
  for (int tick = 0; tick < 10; ++tick, now += 500ms) {
    for (int i = 0; i < 50; ++i) recorder.add(packet(static_cast<std::int64_t>(sent++)), now);
    recorder.tick(now);
    EXPECT_GE(packets_in(recorder.status().file) + 100, sent);
  }
  EXPECT_EQ(recorder.status().packets, sent);
  EXPECT_EQ(recorder.status().dropped, 0u);
}

TEST_F(RecordingTest, RotatesBySizeAndLosesNothing) {
  config_.rotate_bytes = 10'000;
  records_.resize(500, 3);
  {
    Recorder recorder(config_);
    for (std::int64_t n = 0; n < 200; ++n) recorder.add(packet(n), SteadyTime(100s));
  }
  std::size_t packets = 0;
  const auto names = files();
  EXPECT_GE(names.size(), 8u);
  for (const std::string& name : names) packets += packets_in(name);
  EXPECT_EQ(packets, 200u);
}

TEST_F(RecordingTest, RotatesByAgeAndOnRequest) {
  config_.rotate_age = 60s;
  Recorder recorder(config_);
  recorder.add(packet(1), SteadyTime(100s));
  recorder.tick(SteadyTime(159s));
  EXPECT_FALSE(recorder.status().file.empty());
  recorder.tick(SteadyTime(160s));
  EXPECT_TRUE(recorder.status().file.empty());
  recorder.add(packet(2), SteadyTime(161s));
  recorder.rotate();
  recorder.rotate();
  EXPECT_EQ(recorder.status().files, 2u);
  EXPECT_EQ(files().size(), 2u);
}

TEST_F(RecordingTest, RemovesWhatIsTooOldOrTooMuchButOnlyItsOwn) {
  fs::create_directories(config_.folder);
  const auto make = [&](const std::string& name, std::chrono::hours age) {
    const std::string path = config_.folder + "/" + name;
    std::ofstream(path) << std::string(1000, 'x');
    fs::last_write_time(path, fs::file_time_type::clock::now() - age);
  };
  make("csipose-old.mcap", 48h);
  make("csipose-2.mcap", 3h);
  make("csipose-3.mcap", 2h);
  make("csipose-4.mcap", 1h);
  make("mine.mcap", 1000h);
  make("csipose-notes.txt", 1000h);
  config_.keep_age = 24h;
  config_.keep_bytes = 2500;
  Recorder recorder(config_);
  std::vector<std::string> left;
  for (const std::string& path : files()) left.push_back(fs::path(path).filename());
  EXPECT_EQ(left,
            (std::vector<std::string>{"csipose-3.mcap", "csipose-4.mcap", "csipose-notes.txt", "mine.mcap"}));
}

TEST_F(RecordingTest, AFolderThatCannotBeIsSaidCountedAndTriedAgain) {
  std::ofstream(config_.folder) << "a file where the folder should be";
  Recorder recorder(config_);
  recorder.add(packet(1), SteadyTime(100s));
  recorder.add(packet(2), SteadyTime(105s));
  EXPECT_EQ(recorder.status().dropped, 2u);
  EXPECT_EQ(recorder.status().errors, 1u) << "tried once in ten seconds";
  EXPECT_FALSE(recorder.status().error.empty());
  fs::remove(config_.folder);
  recorder.add(packet(3), SteadyTime(110s));
  EXPECT_EQ(recorder.status().dropped, 2u);
  EXPECT_TRUE(recorder.status().error.empty());
  EXPECT_EQ(recorder.status().files, 1u);
}

TEST_F(RecordingTest, WithoutSchemaThereIsNoPoseChannel) {
  const std::string path = folder_ + "/a.mcap";
  {
    RecordingWriter writer(path, config_.info, {});
    writer.add(packet(1));
  }
  EXPECT_EQ(packets_in(path), 1u);
}

}  // namespace
}  // namespace csipose
