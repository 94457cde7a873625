#include "capture/dat_file.h"

#include <gtest/gtest.h>

#include "proto/result.h"
#include "tests/capture/dat_maker.h"
#include "tests/shared_data.h"

namespace csipose {
namespace {

using namespace testing;

Bytes side_file(const std::vector<std::pair<std::uint32_t, std::uint32_t>>& stamps, bool wide = false) {
  Bytes bytes(stamps.size() * (wide ? 16 : 8));
  for (std::size_t i = 0; i < stamps.size(); ++i) {
    store_le<std::uint32_t>(bytes.data() + i * (wide ? 16 : 8), stamps[i].first);
    store_le<std::uint32_t>(bytes.data() + i * (wide ? 16 : 8) + (wide ? 8 : 4), stamps[i].second);
  }
  return bytes;
}

std::vector<std::int64_t> times_of(const DatFile& file) {
  std::vector<std::int64_t> times;
  for (const DatPacket& packet : file.packets()) times.push_back(packet.arrival_ns);
  return times;
}

std::string words_of(const std::string& path, const DatOptions& options = {}) {
  try {
    DatFile file(path, options);
  } catch (const SetupError& error) {
    return error.what();
  }
  return "no error";
}

TEST(NicLine, UnwrapsTheCounter) {
  const NicLine line = unwrap_nic_clock({0xFFFFFF00u, 0xFFFFFFF0u, 0x10u, 0x100u});
  EXPECT_EQ(line.time_ns, (std::vector<std::int64_t>{0, 240'000, 272'000, 512'000}));
  EXPECT_EQ(line.steps, 0u);
}

TEST(NicLine, ReplacesAStepByTheUsualDistance) {
  const NicLine line = unwrap_nic_clock({1000, 2000, 3000, 4000, 100, 1100, 90'001'100});
  EXPECT_EQ(line.time_ns,
            (std::vector<std::int64_t>{0, 1'000'000, 2'000'000, 3'000'000, 4'000'000, 5'000'000, 6'000'000}));
  EXPECT_EQ(line.steps, 2u);
}

TEST(NicLine, KeepsAPauseOfTheTransmitter) {
  EXPECT_EQ(unwrap_nic_clock({0, 1000, 30'001'000}).time_ns.back(), 30'001'000'000);
}

TEST(NicLine, SeesAClockThatStandsStill) {
  EXPECT_TRUE(unwrap_nic_clock(std::vector<std::uint32_t>(29, 4)).stands_still);
  EXPECT_TRUE(unwrap_nic_clock({4, 4, 4}).stands_still);
  EXPECT_FALSE(unwrap_nic_clock({4, 4, 4, 4, 4, 4, 4, 5}).stands_still);
  EXPECT_FALSE(unwrap_nic_clock({4}).stands_still);
  EXPECT_FALSE(unwrap_nic_clock({}).stands_still);
}

TEST(SideFile, ReadsNarrowAndWideStamps) {
  const std::vector<std::int64_t> expected = {1'700'000'000'000'001'000, 1'700'000'001'999'999'000};
  const std::vector<std::pair<std::uint32_t, std::uint32_t>> stamps = {{1'700'000'000, 1},
                                                                       {1'700'000'001, 999'999}};
  EXPECT_EQ(parse_side_file(side_file(stamps), 2), expected);
  EXPECT_EQ(parse_side_file(side_file(stamps, true), 2), expected);
}

TEST(SideFile, CutOrForeignBytes) {
  Bytes cut = side_file({{1, 2}, {3, 4}});
  cut.resize(11);
  EXPECT_EQ(parse_side_file(cut, 2).size(), 1u);
  EXPECT_TRUE(parse_side_file(Bytes(64, 0xEE), 2).empty());
  EXPECT_TRUE(parse_side_file(Bytes{}, 2).empty());
}

TEST(DatFile, PairsFramesWithTheirCsi) {
  Folder folder;
  Bytes log = frame_record(1);
  append(log, csi_record(1000, 1));
  append(log, Bytes{0, 2, 0xD0, 9});
  append(log, frame_record(2));  // no CSI
  append(log, frame_record(3));
  append(log, Bytes{0, 2, 0xD0, 9});
  append(log, csi_record(3000, 2));
  append(log, csi_record(4000, 3));
  const DatFile file(folder.write("a.dat", log));
  ASSERT_EQ(file.packets().size(), 4u);
  Bytes scratch;
  const auto records = [&](std::size_t i) { return copy(DatFile::records(file.packets()[i], scratch)); };
  Bytes first = frame_record(1), third = frame_record(3);
  append(first, csi_record(1000, 1));
  append(third, csi_record(3000, 2));
  EXPECT_EQ(records(0), first);
  EXPECT_EQ(records(1), frame_record(2));
  EXPECT_EQ(records(2), third);
  EXPECT_EQ(records(3), csi_record(4000, 3));
  EXPECT_EQ(times_of(file), (std::vector<std::int64_t>{0, 2'000'000, 2'000'000, 3'000'000}));
  EXPECT_EQ(ns(file.period()), 3'000'000 + 2'000'000)
      << "the usual distance is the median, the upper one of 1 and 2 ms";
}

TEST(DatFile, TakesTimesFromTheSideFile) {
  Folder folder;
  Bytes log = frame_record(1);
  append(log, csi_record(4, 1));
  append(log, csi_record(4, 2));
  append(log, csi_record(4, 3));
  const std::string path = folder.write("a.dat", log);
  folder.write("a.datstp", side_file({{100, 1}, {100, 2}, {100, 500}, {100, 400}}));
  const DatFile file(path);
  EXPECT_TRUE(file.has_utc());
  EXPECT_EQ(times_of(file), (std::vector<std::int64_t>{100'000'002'000, 100'000'500'000, 100'000'500'000}));
  EXPECT_EQ(file.clock_steps(), 1u);

  folder.write("a.datstp", side_file({{100, 1}, {100, 2}, {100, 500}}));
  EXPECT_EQ(DatFile(path).packets().size(), 2u) << "what has no stamp has no time";
  folder.write("a.datstp", Bytes(64, 0xEE));
  EXPECT_NE(words_of(path).find("is not a side file"), std::string::npos);
}

TEST(DatFile, AStandingClockNeedsARate) {
  Folder folder;
  Bytes log;
  for (std::uint16_t i = 0; i < 10; ++i) append(log, csi_record(4, i));
  const std::string path = folder.write("a.dat", log);
  EXPECT_NE(words_of(path).find("stands still"), std::string::npos);
  const DatFile file(path, {100});
  EXPECT_EQ(file.packets()[9].arrival_ns, 90'000'000);
  EXPECT_EQ(ns(file.period()), 100'000'000);
}

TEST(DatFile, SaysWhatCannotBeRead) {
  Folder folder;
  EXPECT_NE(words_of(folder.path("absent.dat")).find("No such file"), std::string::npos);
  EXPECT_NE(words_of(folder.path("")).find("is not a file"), std::string::npos);
  EXPECT_NE(words_of(folder.write("empty.dat", {})).find("not a csitool log"), std::string::npos);
  EXPECT_NE(words_of(folder.write("text.dat", Bytes(5000, 'a'))).find("not a csitool log"),
            std::string::npos);
}

TEST(DatFile, ReadsTheRealRecordings) {
  CSIPOSE_NEEDS_SHARED_DATA();
  const DatFile monitor(shared_data("csi5300/sample_0x5_64_3000.dat").string());
  EXPECT_EQ(monitor.packets().size(), 2998u);
  EXPECT_EQ(monitor.packets()[0].frame.code, 0xC1);
  EXPECT_EQ(monitor.clock_steps(), 0u);
  EXPECT_NEAR(seconds(monitor.period()), 3.0, 0.01);
  EXPECT_EQ(DatFile(shared_data("csi5300/sample_0x1_ap.dat").string()).packets().size(), 540u);
  const std::string standing = shared_data("csi5300/log.all_csi.6.7.6.dat").string();
  EXPECT_NE(words_of(standing).find("stands still"), std::string::npos);
  EXPECT_EQ(DatFile(standing, {10}).packets().size(), 29u);
}

}  // namespace
}  // namespace csipose
