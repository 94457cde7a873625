// Three receivers of one transmitter with offset, skew, losses, stalls and wraps, and what is known of them:
// by counter and by time alone, every frame must come to lie beside the same frames.
#include <gtest/gtest.h>

#include <fstream>
#include <iterator>
#include <map>

#include "capture/front_end.h"
#include "proto/npy.h"
#include "tests/capture/made_up_packets.h"
#include "tests/shared_data.h"

namespace csipose {
namespace {

using testing::StoredPacket;

template <class T>
std::vector<std::int64_t> read_numbers(const std::string& name) {
  const auto array = read_npy<T>(testing::shared_data("csi5300/sync/" + name));
  return {array.data.begin(), array.data.end()};
}

/// The recording of one receiver, a packet per CSI record, with its 0xC1 before it unless told otherwise.
std::vector<StoredPacket> read_receiver(std::uint8_t receiver, bool with_frames) {
  const std::string name = "rx" + std::to_string(receiver);
  std::ifstream file(testing::shared_data("csi5300/sync/" + name + ".dat"), std::ios::binary);
  const std::vector<char> bytes((std::istreambuf_iterator<char>(file)), std::istreambuf_iterator<char>());
  const auto arrival_ns = read_numbers<std::int64_t>(name + "_arrival_ns.npy");
  const auto truth = read_numbers<std::int32_t>(name + "_tx_index.npy");
  RecordStream stream(ByteView(bytes), RecordStream::Policy::strict);
  std::vector<StoredPacket> packets;
  std::vector<std::uint8_t> pending;
  while (const auto record = stream.next()) {
    const ByteView framed = record->framed();
    if (record->code == kCsiCode || with_frames) pending.insert(pending.end(), framed.begin(), framed.end());
    if (record->code != kCsiCode) continue;
    const std::size_t i = packets.size();
    packets.push_back({receiver, SteadyTime{Nanoseconds{arrival_ns.at(i)}}, pending, truth.at(i)});
    pending.clear();
  }
  EXPECT_EQ(packets.size(), truth.size());
  return packets;
}

std::vector<StoredPacket> read_all(bool with_frames) {
  std::vector<StoredPacket> packets;
  for (std::uint8_t r = 0; r < kReceivers; ++r) {
    auto more = read_receiver(r, with_frames);
    packets.insert(packets.end(), more.begin(), more.end());
  }
  std::stable_sort(packets.begin(), packets.end(),
                   [](const auto& a, const auto& b) { return a.arrival < b.arrival; });
  return packets;
}

FrontEndConfig every_frame_once(AlignMethod align) {
  FrontEndConfig config;
  config.grid_hz = 1000;
  config.hop = kSamples;
  config.max_gap = kSamples;  // receivers with gaps stay in the window, so that x can be compared
  config.align = align;
  return config;
}

/// The first 60 numbers that this packet's record should give to a window.
Features features_of(const StoredPacket& packet) {
  RecordStream stream(ByteView(packet.bytes), RecordStream::Policy::strict);
  Features features{};
  while (const auto record = stream.next()) {
    CsiRecord csi;
    if (record->code != kCsiCode || decode_bfee(record->body, csi)) continue;
    EXPECT_TRUE(extract_features(csi, {}, features));
  }
  return features;
}

/// Every received frame lies at slot = truth + constant, with its own CSI; every other sample is not
/// `received`.
void expect_grouping_of_truth(const std::vector<Window>& windows, const std::vector<StoredPacket>& packets) {
  std::map<std::pair<std::int64_t, std::uint8_t>, const StoredPacket*> truth;
  for (const auto& packet : packets) truth[{packet.truth, packet.receiver}] = &packet;
  std::size_t found = 0;
  for (const Window& window : windows)
    for (std::size_t t = 0; t < kSamples; ++t)
      for (std::uint8_t r = 0; r < kReceivers; ++r) {
        const std::int64_t slot = window.end_slot - static_cast<std::int64_t>(kSamples - 1 - t);
        const auto here = truth.find({slot, r});
        const bool received = window.samples[t][r] == SampleState::received;
        ASSERT_EQ(received, here != truth.end()) << "slot " << slot << " receiver " << int(r);
        if (!received) continue;
        ++found;
        if (!window.links[3 * r]) continue;
        const Features features = features_of(*here->second);
        for (std::size_t c = 0; c < kChannels; ++c)
          for (std::size_t a = 0; a < kAntennas; ++a)
            ASSERT_EQ(window.x[Window::index(c, t, 3 * r + a)], features[c * kAntennas + a]) << slot;
      }
  EXPECT_EQ(found, packets.size());
}

class FrontEndSync : public ::testing::TestWithParam<AlignMethod> {};

TEST_P(FrontEndSync, PutsEveryFrameBesideItsOwn) {
  CSIPOSE_NEEDS_SHARED_DATA();
  const bool by_counter = GetParam() == AlignMethod::tx_counter;
  const auto packets = read_all(by_counter);
  FrontEnd front_end(every_frame_once(GetParam()));
  const auto windows = testing::run(front_end, packets, std::chrono::milliseconds(60));
  ASSERT_EQ(windows.size(), 1200 / kSamples);
  expect_grouping_of_truth(windows, packets);
}

TEST_P(FrontEndSync, TellsClocksAndLosses) {
  CSIPOSE_NEEDS_SHARED_DATA();
  const bool by_counter = GetParam() == AlignMethod::tx_counter;
  FrontEnd front_end(every_frame_once(GetParam()));
  testing::run(front_end, read_all(by_counter), std::chrono::milliseconds(60));
  front_end.finish();
  const auto& receivers = front_end.stats().receivers;
  EXPECT_NEAR(receivers[1].skew_ppm - receivers[0].skew_ppm, -11.7 - 6.4, 0.5);
  EXPECT_NEAR(receivers[2].skew_ppm - receivers[0].skew_ppm, 2.9 - 6.4, 0.5);
  const double elapsed_s = 1.2;  // offsets are given at the first frame and told at the last
  EXPECT_NEAR(receivers[1].offset_s - receivers[0].offset_s, 4294.367296 - 40.121045 - 18.1e-6 * elapsed_s,
              4e-6);
  EXPECT_NEAR(receivers[2].offset_s - receivers[0].offset_s, 1234.567890 - 40.121045 - 3.5e-6 * elapsed_s,
              4e-6);
  for (std::size_t r = 1; r < kReceivers; ++r) EXPECT_LT(receivers[r].residual_s, 2e-6);
  EXPECT_EQ(receivers[0].lost_air, 12U);
  EXPECT_EQ(receivers[1].lost_air, 55U);
  EXPECT_EQ(receivers[2].lost_air, 17U);
  for (const auto& receiver : receivers) {
    EXPECT_EQ(receiver.lost_driver, 0U);
    EXPECT_EQ(receiver.duplicates, 0U);
    EXPECT_EQ(receiver.unplaced + receiver.no_counter, 0U);
    EXPECT_GT(receiver.match_ratio, 0.99);
  }
  EXPECT_DOUBLE_EQ(front_end.stats().tx_hz, 1000);
}

INSTANTIATE_TEST_SUITE_P(, FrontEndSync, ::testing::Values(AlignMethod::tx_counter, AlignMethod::time),
                         [](const auto& test) {
                           return test.param == AlignMethod::time ? "ByTime" : "ByCounter";
                         });

}  // namespace
}  // namespace csipose
