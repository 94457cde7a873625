// Real recordings, through the source that replays them, into windows.
#include <gtest/gtest.h>

#include <vector>

#include "capture/front_end.h"
#include "capture/replay.h"
#include "tests/shared_data.h"

namespace csipose {
namespace {

struct Outcome {
  FrontEndStats stats;
  std::vector<LinkSet> links;
  std::vector<std::uint16_t> reasons;
};

Outcome replay(const std::vector<std::string>& names, const FrontEndConfig& config, double rate_hz = 0) {
  ReplayConfig replay_config;
  replay_config.rate_hz = rate_hz;
  for (const auto& name : names)
    replay_config.files.push_back(testing::shared_data("csi5300/" + name).string());
  const auto source = open_replay(replay_config);
  FrontEnd front_end(config);
  Outcome outcome;
  Window window;
  const auto take = [&] {
    front_end.take(window);
    outcome.links.push_back(window.links);
    outcome.reasons.push_back(window.reasons);
  };
  Packet packet;
  while (source->poll(Nanoseconds{0}, packet) == SourceEvent::packet) {
    while (front_end.next() && packet.arrival > front_end.next()->last_sample + std::chrono::milliseconds(15))
      take();
    front_end.add(packet);
  }
  while (front_end.next() && front_end.next()->end_slot <= front_end.newest_slot()) take();
  front_end.finish();
  outcome.stats = front_end.stats();
  return outcome;
}

TEST(FrontEndRecordings, OneRecordingGivenToThreeReceivers) {
  CSIPOSE_NEEDS_SHARED_DATA();
  const std::string name = "sample_0x5_64_3000.dat";  // 2,998 of 3,000 frames at 1000/s; counters by LFSR
  const Outcome outcome = replay({name, name, name}, {});
  EXPECT_NEAR(outcome.stats.tx_hz, 1000, 2);
  EXPECT_EQ(outcome.stats.restarts + outcome.stats.pauses, 0U);
  EXPECT_NEAR(static_cast<double>(outcome.links.size()), (900 - 20) / 10, 2);
  for (std::size_t i = 0; i < outcome.links.size(); ++i) {
    if (i < 8) continue;  // 33 frames, of which the first windows come too soon
    EXPECT_TRUE(outcome.links[i].all()) << i;
    EXPECT_EQ(outcome.reasons[i], 0) << i;
  }
  for (const ReceiverStats& receiver : outcome.stats.receivers) {
    EXPECT_EQ(receiver.usable, 2998U);
    EXPECT_EQ(receiver.lost_air + receiver.lost_driver + receiver.duplicates + receiver.bad_fcs, 0U);
    EXPECT_EQ(receiver.unplaced + receiver.no_counter, 0U);
    EXPECT_EQ(receiver.match_ratio, 1);
    EXPECT_NEAR(receiver.skew_ppm, 0, 0.01);
  }
}

TEST(FrontEndRecordings, ThreeReceiversOfOneTransmitter) {
  CSIPOSE_NEEDS_SHARED_DATA();
  const Outcome outcome = replay({"sync/rx0.dat", "sync/rx1.dat", "sync/rx2.dat"}, {});
  EXPECT_EQ(outcome.stats.receivers[0].lost_air, 12U);
  EXPECT_EQ(outcome.stats.receivers[1].lost_air, 55U);
  EXPECT_EQ(outcome.stats.receivers[2].lost_air, 17U);
  EXPECT_EQ(outcome.stats.restarts + outcome.stats.pauses, 0U);
  EXPECT_NEAR(static_cast<double>(outcome.links.size()), (360 - 20) / 10, 2);
  std::size_t whole = 0;
  for (const LinkSet& links : outcome.links) whole += links.all();
  EXPECT_GT(whole, outcome.links.size() - 6);  // one gap of 15 frames lies in two windows, the start in some
}

TEST(FrontEndRecordings, WithoutFramesAClientsRecordingIsPlacedByTime) {
  CSIPOSE_NEEDS_SHARED_DATA();
  const std::string name =
      "sample_0x1_ap.dat";  // 540 records at about 10/s, the clock jumps back with its access point
  const Outcome outcome = replay({name, name, name}, {.grid_hz = 10, .max_gap = 4});
  for (const ReceiverStats& receiver : outcome.stats.receivers) {
    EXPECT_EQ(receiver.usable, 540U);
    EXPECT_LT(receiver.no_counter + receiver.unplaced, 60U);
    EXPECT_GT(receiver.match_ratio, 0.9);
  }
  std::size_t whole = 0;
  for (const LinkSet& links : outcome.links) whole += links.all();
  EXPECT_GT(whole, outcome.links.size() / 2);
}

TEST(FrontEndRecordings, TooFewRecordsToAlignByTimeGiveNoWindow) {
  CSIPOSE_NEEDS_SHARED_DATA();
  const std::string name = "log.all_csi.6.7.6.dat";  // 29 records, timestamp always 4
  const Outcome outcome = replay({name, name, name}, {.grid_hz = 20, .tx_hz = 20}, 20);
  EXPECT_EQ(outcome.stats.receivers[0].records, 29U);
  EXPECT_TRUE(outcome.links.empty());
}

}  // namespace
}  // namespace csipose
