#include "capture/replay.h"

#include <gtest/gtest.h>

#include <map>

#include "proto/recording.h"
#include "proto/result.h"
#include "tests/capture/dat_maker.h"
#include "tests/shared_data.h"

namespace csipose {
namespace {

using namespace testing;

struct Given {
  int receiver;
  std::int64_t arrival_ns, utc_ns;
  Bytes records;
};
std::vector<Given> all_of(PacketSource& source, std::size_t most = 100'000) {
  std::vector<Given> given;
  Packet packet;
  while (given.size() < most && source.poll({}, packet) == SourceEvent::packet)
    given.push_back({packet.receiver, ns(packet.arrival), ns(packet.arrival_utc), copy(packet.records)});
  return given;
}
std::vector<Given> replay(const ReplayConfig& config) { return all_of(*open_replay(config)); }

// Frames first..last, 1 ms apart, by a NIC clock that began at `origin_us` and runs `drift` too fast.
Bytes log_of(std::uint64_t first, std::uint64_t last, std::uint32_t origin_us, double drift = 0,
             std::uint64_t lost = 0) {
  Bytes log;
  for (std::uint64_t n = first; n <= last; ++n) {
    if (n == lost) continue;
    append(log, frame_record(n));
    append(log, csi_record(origin_us + static_cast<std::uint32_t>(static_cast<double>(1000 * (n - first)) *
                                                                  (1 + drift)),
                           static_cast<std::uint16_t>(n)));
  }
  return log;
}

TEST(Replay, OneFileInItsOrderAndTime) {
  Folder folder;
  const auto given = replay({{folder.write("a.dat", log_of(1, 5, 77))}});
  ASSERT_EQ(given.size(), 5u);
  for (std::size_t i = 0; i < 5; ++i) {
    EXPECT_EQ(given[i].receiver, 0);
    EXPECT_EQ(given[i].arrival_ns, static_cast<std::int64_t>(i) * 1'000'000);
    EXPECT_EQ(given[i].utc_ns, given[i].arrival_ns) << "counts from 1970";
  }
}

TEST(Replay, CommonFramesTieTheClocks) {
  Folder folder;
  const std::string a = folder.write("a.dat", log_of(100, 1100, 5000));
  const std::string b = folder.write("b.dat", log_of(90, 1000, 0xFFFF0000u, 300e-6, 500));
  const std::string c = folder.write("c.dat", log_of(600, 1200, 42, -300e-6));
  std::map<Bytes, std::vector<Given>> by_frame;
  for (const Given& given : replay({{a, b, c}}))
    by_frame[Bytes(given.records.begin(), given.records.begin() + kCsipRecordBytes)].push_back(given);
  EXPECT_EQ(by_frame.size(), 1111u);
  std::size_t triples = 0;
  for (const auto& [frame, given] : by_frame) {
    for (const Given& g : given) EXPECT_LE(std::abs(g.arrival_ns - given[0].arrival_ns), 1000);
    triples += given.size() == 3;
  }
  EXPECT_EQ(triples, 401u);
}

TEST(Replay, TheSameFileThreeTimesIsOneClock) {
  Folder folder;
  const std::string a = folder.write("a.dat", log_of(1, 100, 5000));
  const auto given = replay({{a, a, a}});
  ASSERT_EQ(given.size(), 300u);
  for (std::size_t i = 0; i < given.size(); ++i) {
    EXPECT_EQ(given[i].receiver, static_cast<int>(i % 3));
    EXPECT_EQ(given[i].arrival_ns, given[i - i % 3].arrival_ns);
  }
}

TEST(Replay, LoopGoesOnInTime) {
  Folder folder;
  const auto source = open_replay({{folder.write("a.dat", log_of(1, 10, 0))}, 0, true});
  const auto given = all_of(*source, 35);
  ASSERT_EQ(given.size(), 35u);
  for (std::size_t i = 0; i < 35; ++i)
    EXPECT_EQ(given[i].arrival_ns, static_cast<std::int64_t>(i) * 1'000'000);
  EXPECT_EQ(given[10].records, given[0].records);
}

TEST(Replay, EndsAndStaysEnded) {
  Folder folder;
  const auto source = open_replay({{folder.write("a.dat", log_of(1, 3, 0))}});
  all_of(*source);
  Packet packet;
  EXPECT_EQ(source->poll({}, packet), SourceEvent::closed);
  EXPECT_EQ(source->poll({}, packet), SourceEvent::closed);
  EXPECT_EQ(source->stats().receivers[0].packets, 3u);
  EXPECT_EQ(source->kind(), Source::replay);
}

TEST(Replay, SideFilesGiveUtcAndOneClock) {
  Folder folder;
  const auto stamped = [&](const std::string& name, std::uint32_t us) {
    const std::string path = folder.write(name, csi_record(4, 1));
    Bytes stamp(8);
    store_le<std::uint32_t>(stamp.data(), 1'700'000'000);
    store_le<std::uint32_t>(stamp.data() + 4, us);
    folder.write(name + "stp", stamp);
    return path;
  };
  const std::string a = stamped("a.dat", 500), b = stamped("b.dat", 200);
  const auto given = replay({{a, b}});
  ASSERT_EQ(given.size(), 2u);
  EXPECT_EQ(given[0].receiver, 1);
  EXPECT_EQ(given[0].arrival_ns, 0);
  EXPECT_EQ(given[1].arrival_ns, 300'000);
  EXPECT_EQ(given[1].utc_ns, 1'700'000'000'000'500'000);

  std::filesystem::remove(b + "stp");
  EXPECT_THROW(open_replay({{a, b}}), SetupError);
}

TEST(Replay, RefusesWithWords) {
  EXPECT_THROW(open_replay({}), SetupError);
  EXPECT_THROW(open_replay({{"a", "b", "c", "d"}}), SetupError);
  EXPECT_THROW(open_replay({{"/nonexistent.dat"}}), SetupError);
}

TEST(Replay, ARecordingGivesBackWhatWasRecorded) {
  Folder folder;
  const std::string path = folder.path("a.mcap");
  std::vector<Given> put;
  {
    RecordingWriter writer(path, {}, {});
    for (int i = 0; i < 1000; ++i) {
      put.push_back({i % 3, 5'000'000'000'123 + i * 333'333, 1'790'000'000'000'000'000 + i * 333'333,
                     csi_record(1u, 1)});
      const Given& g = put.back();
      writer.add(Packet{static_cast<std::uint8_t>(g.receiver), SteadyTime(Nanoseconds(g.arrival_ns)),
                        UtcTime(Nanoseconds(g.utc_ns)), g.records});
    }
  }
  const auto source = open_replay({{path}, 0, true});
  const auto given = all_of(*source, 2500);
  ASSERT_EQ(given.size(), 2500u);
  for (std::size_t i = 0; i < 2500; ++i) {
    EXPECT_EQ(given[i].receiver, put[i % 1000].receiver);
    EXPECT_EQ(given[i].records, put[i % 1000].records);
  }
  for (std::size_t i = 0; i < 1000; ++i) EXPECT_EQ(given[i].arrival_ns, put[i].arrival_ns);
  for (std::size_t i = 1; i < 2500; ++i)
    EXPECT_GT(given[i].arrival_ns, given[i - 1].arrival_ns) << "loop or not";
  EXPECT_EQ(source->kind(), Source::replay);
  EXPECT_TRUE(source->stats().refusals.empty());
  EXPECT_THROW(open_replay({{path, path}}), SetupError);
}

TEST(Replay, ARecordingWithoutCsiIsRefused) {
  Folder folder;
  { McapWriter empty(folder.path("a.mcap"), "test"); }
  EXPECT_THROW(open_replay({{folder.path("a.mcap")}}), SetupError);
}

TEST(Replay, SyncSetFramesMeetInTime) {
  CSIPOSE_NEEDS_SHARED_DATA();
  ReplayConfig config;
  for (const char* name : {"rx0", "rx1", "rx2"})
    config.files.push_back(shared_data(std::string("csi5300/sync/") + name + ".dat").string());
  std::map<Bytes, std::vector<std::int64_t>> times;  // by frame
  for (const Given& given : replay(config)) {
    ASSERT_EQ(given.records[2], 0xC1);
    const std::size_t frame = 2u + load_be16(given.records.data());
    times[Bytes(given.records.begin(), given.records.begin() + static_cast<std::ptrdiff_t>(frame))].push_back(
        given.arrival_ns);
  }
  std::size_t triples = 0;
  for (const auto& [frame, at] : times) {
    triples += at.size() == 3;
    EXPECT_LE(at.back() - at.front(), 100'000) << "clocks differ by 7 s and 18 ppm, frames by nothing";
  }
  EXPECT_EQ(triples, 1117u);  // truth.json
}

}  // namespace
}  // namespace csipose
