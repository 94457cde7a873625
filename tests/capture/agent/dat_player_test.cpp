#include "capture/agent/dat_player.h"

#include <gtest/gtest.h>

#include "proto/crc32.h"
#include "proto/result.h"
#include "tests/capture/dat_maker.h"

namespace csipose {
namespace {

using namespace testing;
using namespace std::chrono_literals;

// 4 records, 10 ms apart by the NIC, no frames.
Bytes bare_log() {
  Bytes log;
  for (std::uint16_t i = 0; i < 4; ++i)
    append(log, csi_record(7000u + 10'000u * i, static_cast<std::uint16_t>(100 + i)));
  return log;
}

struct Sent {
  SteadyTime at;
  std::uint64_t counter;  // of the CSIP frame
  std::uint32_t timestamp_us;
  std::uint16_t bfee_count;
};
Sent take(DatPlayer& player) {
  Sent sent{player.next_at(), 0, 0, 0};
  const Bytes records = copy(player.take());
  EXPECT_EQ(records[2], 0xC1);
  const ByteView frame(records.data() + 3, kCsipRecordBytes - 3);
  EXPECT_EQ(crc32(frame.sub(0, frame.size() - 4)), load_le<std::uint32_t>(frame.end() - 4)) << "FCS";
  sent.counter = load_le<std::uint64_t>(frame.data() + 24 + 8);
  const std::uint8_t* const csi = records.data() + kCsipRecordBytes;
  EXPECT_EQ(csi[2], 0xBB);
  sent.timestamp_us = load_le<std::uint32_t>(csi + 3);
  sent.bfee_count = load_le<std::uint16_t>(csi + 7);
  return sent;
}

TEST(DatPlayer, PlainFileIsSentAsItIs) {
  Folder folder;
  const Bytes first = joined(frame_record(5), csi_record(1000, 1)), second = csi_record(3000, 2);
  DatPlayer player(folder.write("a.dat", joined(first, second)), {});
  player.start(SteadyTime(5s));
  EXPECT_EQ(player.next_at(), SteadyTime(5s));
  EXPECT_EQ(copy(player.take()), first);
  EXPECT_EQ(player.next_at(), SteadyTime(5s + 2ms));
  EXPECT_EQ(copy(player.take()), second);
  EXPECT_TRUE(player.ended());
}

TEST(DatPlayer, RatePacesAndRetimes) {
  Folder folder;
  DatPlayer player(folder.write("a.dat", bare_log()), {1000, false, false});
  player.start(SteadyTime(2s));
  for (std::int64_t i = 0; i < 4; ++i) {
    EXPECT_EQ(player.next_at(), SteadyTime(2s + i * 1ms));
    const Bytes record = copy(player.take());
    EXPECT_EQ(load_le<std::uint32_t>(record.data() + 3), 2'000'000u + 1000u * static_cast<std::uint32_t>(i));
    EXPECT_EQ(load_le<std::uint16_t>(record.data() + 7), 100 + i) << "the count stays the file's";
  }
}

TEST(DatPlayer, InjectsACounterWhereThereIsNone) {
  Folder folder;
  DatPlayer player(folder.write("a.dat", bare_log()), {0, false, true});
  player.start(SteadyTime(1s));
  for (std::uint64_t i = 0; i < 4; ++i) {
    const Sent sent = take(player);
    EXPECT_EQ(sent.counter, i);
    EXPECT_EQ(sent.timestamp_us, 7000 + 10'000 * i) << "the clock stays the file's";
  }
  const Bytes own = joined(frame_record(77), csi_record(1, 1));
  DatPlayer counted(folder.write("b.dat", own), {0, false, true});
  counted.start({});
  EXPECT_EQ(copy(counted.take()), own) << "a file that counts already is left alone";
}

TEST(DatPlayer, ALoopGoesOnCounting) {
  Folder folder;
  DatPlayer player(folder.write("a.dat", bare_log()), {0, true, false});
  player.start(SteadyTime(80s));  // a multiple of the period, 40 ms
  const Sent first = take(player);
  for (std::uint64_t i = 1; i < 50; ++i) {
    const Sent sent = take(player);
    EXPECT_EQ(sent.counter, first.counter + i);
    EXPECT_EQ(sent.bfee_count, static_cast<std::uint16_t>(first.bfee_count + i));
    EXPECT_EQ(sent.timestamp_us, first.timestamp_us + 10'000 * i);
    EXPECT_EQ(sent.at, first.at + static_cast<std::int64_t>(i) * 10ms);
  }
}

TEST(DatPlayer, LoopsAreInStepWheneverTheyStart) {
  Folder folder;
  const std::string path = folder.write("a.dat", bare_log());
  DatPlayer early(path, {300, true, false}), late(path, {300, true, false});
  early.start(SteadyTime(100s));
  late.start(SteadyTime(100s + 123'456us));
  Sent a = take(early);
  const Sent b = take(late);
  EXPECT_GE(b.at, SteadyTime(100s + 123'456us));
  EXPECT_LT(b.at, SteadyTime(100s + 123'456us + 4ms));
  while (a.counter < b.counter) a = take(early);
  EXPECT_EQ(a.counter, b.counter);
  EXPECT_EQ(a.at, b.at);
  EXPECT_EQ(a.timestamp_us, b.timestamp_us);
}

TEST(DatPlayer, FilesOfTheSameFramesAreInStepThoughEachLostSome) {
  Folder folder;
  const auto log = [](std::vector<std::uint64_t> frames) {
    Bytes bytes;
    for (const std::uint64_t n : frames)
      append(bytes, joined(frame_record(n), csi_record(static_cast<std::uint32_t>(n * 1000), 1)));
    return bytes;
  };
  DatPlayer a(folder.write("a.dat", log({10, 11, 12, 13, 14})), {100, true, false});
  DatPlayer b(folder.write("b.dat", log({10, 12, 14})), {100, true, false});
  a.start(SteadyTime(50s));
  b.start(SteadyTime(50s));
  for (int i = 0; i < 20; ++i) {
    const Sent sent = take(b);
    Sent same = take(a);
    while (same.counter < sent.counter) same = take(a);
    EXPECT_EQ(same.counter, sent.counter);
    EXPECT_EQ(same.at, sent.at);
  }
}

TEST(DatPlayer, RefusesWhatHasNoClock) {
  Folder folder;
  Bytes log;
  for (std::uint16_t i = 0; i < 10; ++i) append(log, csi_record(4, i));
  const std::string path = folder.write("a.dat", log);
  EXPECT_THROW(DatPlayer(path, {}), SetupError);
  EXPECT_EQ(DatPlayer(path, {100, false, false}).packets(), 10u);
}

}  // namespace
}  // namespace csipose
