// Made-up receivers with known faults in, windows out. Subcarrier 0 of every sample tells which frame it is.
#include "capture/front_end.h"

#include <gtest/gtest.h>

#include <cstring>

#include "tests/capture/made_up_packets.h"

namespace csipose {
namespace {

using testing::csip_frame;
using testing::MadeUpReceiver;
using testing::MadeUpTransmitter;
using testing::StoredPacket;
using testing::tag;

MadeUpTransmitter csip_transmitter(double hz = 300, std::int64_t frames = 600) {
  MadeUpTransmitter transmitter;
  transmitter.hz = hz;
  transmitter.frames = frames;
  transmitter.frame_record = [](std::int64_t frame) {
    return csip_frame(static_cast<std::uint64_t>(frame) + 1000);
  };
  return transmitter;
}

std::vector<MadeUpReceiver> three_receivers() {
  std::vector<MadeUpReceiver> receivers(3);
  receivers[0] = {.offset_us = 40e6, .skew_ppm = 6.4, .jitter_ms = 0.2};
  receivers[1] = {
      .offset_us = 4294.0e6, .skew_ppm = -11.7, .path_ms = 0.7, .jitter_ms = 0.2, .bfee_count = 30000};
  receivers[2] = {.offset_us = 1234e6, .skew_ppm = 2.9, .jitter_ms = 0.3, .bfee_count = 65400};
  return receivers;
}

/// The frame whose sample this is; -1 where there is none.
int frame_tag(const Window& window, std::size_t t, std::size_t receiver) {
  return static_cast<int>(window.x[Window::index(0, t, 3 * receiver)]);
}
std::int64_t slot_of(const Window& window, std::size_t t) {
  return window.end_slot - static_cast<std::int64_t>(kSamples - 1 - t);
}

/// Every window is whole, and the sample of each slot is the frame that `frame_of_slot` says.
void expect_whole(const std::vector<Window>& windows,
                  const std::function<std::int64_t(std::int64_t)>& frame_of_slot) {
  for (const Window& window : windows) {
    ASSERT_TRUE(window.links.all()) << window.end_slot;
    EXPECT_EQ(window.reasons, 0) << window.end_slot;
    for (std::size_t t = 0; t < kSamples; ++t)
      for (std::uint8_t r = 0; r < kReceivers; ++r)
        ASSERT_EQ(frame_tag(window, t, r), tag(r, frame_of_slot(slot_of(window, t))))
            << slot_of(window, t) << " " << int(r);
  }
}
std::int64_t same(std::int64_t slot) { return slot; }

std::uint64_t total(const FrontEnd& front_end, std::uint64_t ReceiverStats::*counter) {
  std::uint64_t sum = 0;
  for (const auto& receiver : front_end.stats().receivers) sum += receiver.*counter;
  return sum;
}

TEST(FrontEnd, EqualRatesUseEveryFrameOnce) {
  FrontEnd front_end({});
  const auto windows = run(front_end, make_packets(csip_transmitter(), three_receivers()));
  EXPECT_EQ(windows.size(), 59U);  // (600 - 20) / 10 + 1
  expect_whole(windows, same);
  EXPECT_EQ(front_end.stats().windows, 59U);
  EXPECT_EQ(front_end.stats().windows_masked, 0U);
  EXPECT_EQ(front_end.stats().tx_hz, 300);  // measured, then taken for the grid's
  EXPECT_EQ(total(front_end, &ReceiverStats::usable), 1800U);
  EXPECT_EQ(total(front_end, &ReceiverStats::late) + total(front_end, &ReceiverStats::duplicates), 0U);
  EXPECT_EQ(windows.back().receivers[0].last_counter, 1000U + 599 - 0);
  EXPECT_NEAR(windows.back().receivers[1].rate_hz, 300, 3);
  EXPECT_FLOAT_EQ(windows.back().receivers[1].rssi_dbm[1], 32 - 44 - 40);
  EXPECT_EQ(windows.back().receivers[2].missing_ratio, 0);
}

TEST(FrontEnd, AFasterTransmitterIsThinnedToTheNewestFrameOfEachSlot) {
  FrontEnd front_end({.tx_hz = 1000});
  const auto windows = run(front_end, make_packets(csip_transmitter(1000, 2000), three_receivers()));
  EXPECT_GT(windows.size(), 55U);
  expect_whole(windows, [](std::int64_t slot) {
    return (10 * (slot + 1) + 2) / 3 - 1;
  });  // last with floor(0.3 f) = slot
}

TEST(FrontEnd, MeasuresARateThatIsNotTheGrids) {
  FrontEnd front_end({});
  const auto windows = run(front_end, make_packets(csip_transmitter(1000, 2000), three_receivers()));
  EXPECT_NEAR(front_end.stats().tx_hz, 1000, 1);
  for (const Window& window : windows) EXPECT_TRUE(window.links.all());
  EXPECT_NEAR(static_cast<double>(front_end.newest_slot()), 600, 1);
}

TEST(FrontEnd, WrapsOfAllCountersChangeNothing) {
  auto transmitter = csip_transmitter();
  transmitter.frame_record = [](std::int64_t f) {
    return testing::sequence16_frame(static_cast<std::uint64_t>(65'300 + f));
  };
  auto receivers = three_receivers();
  receivers[1].offset_us = 4294'967'296.0 - 0.7e6;
  receivers[1].bfee_count = 65'300;
  FrontEnd front_end({.counter = CounterMethod::sequence16});
  expect_whole(run(front_end, make_packets(transmitter, receivers)), same);
  EXPECT_EQ(total(front_end, &ReceiverStats::clock_epochs) + total(front_end, &ReceiverStats::lost_driver),
            0U);
}

TEST(FrontEnd, CountersNearTheEndOf64Bits) {
  auto transmitter = csip_transmitter();
  transmitter.frame_record = [](std::int64_t f) {
    return csip_frame(~std::uint64_t{0} - 100 + static_cast<std::uint64_t>(f));
  };
  FrontEnd front_end({});
  expect_whole(run(front_end, make_packets(transmitter, three_receivers())), same);
}

TEST(FrontEnd, DuplicatesAndReorderedPacketsChangeNothing) {
  auto packets = make_packets(csip_transmitter(), three_receivers());
  for (std::size_t i = 30; i + 9 < packets.size(); i += 40) {
    testing::delay_packet(packets, i, 9);  // three frames on
    testing::repeat_packet(packets, i);
  }
  FrontEnd front_end({});
  expect_whole(run(front_end, packets), same);
  EXPECT_EQ(total(front_end, &ReceiverStats::duplicates), packets.size() - 1800);
  EXPECT_EQ(total(front_end, &ReceiverStats::lost_driver), 0U);
  EXPECT_EQ(total(front_end, &ReceiverStats::clock_epochs), 0U);
}

TEST(FrontEnd, AStepBackOfTheClockIsAnEpochAndNothingMore) {
  const auto transmitter = csip_transmitter();
  auto packets = make_packets(transmitter, three_receivers());
  for (auto& packet : packets)
    if (packet.receiver == 1 && packet.truth >= 300) {
      const std::size_t timestamp =
          packet.bytes.size() - 215 + 3;  // a 3x1 record with its framing has 215 bytes
      store_le(&packet.bytes[timestamp], load_le<std::uint32_t>(&packet.bytes[timestamp]) - 5'000'000);
    }
  FrontEnd front_end({});
  expect_whole(run(front_end, packets), same);
  EXPECT_EQ(front_end.stats().receivers[1].clock_epochs, 1U);
  EXPECT_EQ(total(front_end, &ReceiverStats::clock_epochs), 1U);
}

TEST(FrontEnd, AFrozenClockLeavesTheCounters) {
  auto receivers = three_receivers();
  receivers[0].skew_ppm = -1e6;  // stands still
  FrontEnd front_end({});
  expect_whole(run(front_end, make_packets(csip_transmitter(), receivers)), same);
  EXPECT_TRUE(std::isnan(front_end.stats().receivers[0].skew_ppm));
  EXPECT_NEAR(front_end.stats().receivers[2].skew_ppm - front_end.stats().receivers[1].skew_ppm, 14.6, 1);
}

TEST(FrontEnd, ADeadReceiverIsMaskedAndComesBack) {
  auto receivers = three_receivers();
  receivers[1].deaf = [](std::int64_t frame) { return frame >= 200 && frame < 400; };
  FrontEnd front_end({});
  const auto windows = run(front_end, make_packets(csip_transmitter(), receivers));
  ASSERT_EQ(windows.size(), 59U);
  for (const Window& window : windows) {
    const std::int64_t last = window.end_slot, first = last - 19;
    const bool whole = last < 200 || first >= 400;
    const bool touches = last >= 202 && first < 400;  // two slots may be filled
    if (whole) {
      EXPECT_EQ(window.links, LinkSet(0x1FF)) << last;
    } else if (touches) {
      EXPECT_EQ(window.links, LinkSet(0x1C7)) << last;
      EXPECT_EQ(window.reasons, kReceiverMissing | kGap) << last;
    }
    for (std::size_t t = 0; t < kSamples; ++t) {
      EXPECT_EQ(frame_tag(window, t, 0), tag(0, slot_of(window, t)));
      EXPECT_EQ(
          frame_tag(window, t, 1),
          window.links[3] ? tag(1, std::min<std::int64_t>(slot_of(window, t), last < 210 ? 199 : 600)) : 0);
    }
  }
  front_end.finish();
  EXPECT_EQ(front_end.stats().receivers[1].lost_air, 200U);
  EXPECT_EQ(front_end.stats().receivers[0].lost_air, 0U);
}

TEST(FrontEnd, ALateJoinerLandsOnTheSameLine) {
  auto receivers = three_receivers();
  receivers[2].deaf = [](std::int64_t frame) { return frame < 250; };
  auto transmitter = csip_transmitter();
  transmitter.frame_record = [](std::int64_t f) {
    return testing::sequence16_frame(static_cast<std::uint64_t>(65'400 + f));
  };
  FrontEnd front_end({.counter = CounterMethod::sequence16});
  for (const Window& window : run(front_end, make_packets(transmitter, receivers))) {
    if (window.end_slot - 19 >= 250) {
      expect_whole({window}, same);
    } else {
      EXPECT_FALSE(window.links[8]);
    }
  }
}

TEST(FrontEnd, FillsFromTheNearestOlderSampleWithinMaxGap) {
  auto receivers = three_receivers();
  receivers[0].deaf = [](std::int64_t frame) { return frame == 105 || (frame >= 130 && frame < 132); };
  receivers[1].deaf = [](std::int64_t frame) { return frame >= 210 && frame < 213; };  // one too many
  FrontEnd front_end({.hop = 20, .max_gap = 2});
  const auto windows = run(front_end, make_packets(csip_transmitter(), receivers));
  const Window& five = windows.at(5);  // slots 100..119
  EXPECT_TRUE(five.links.all());
  EXPECT_EQ(five.reasons, kGap);
  EXPECT_EQ(five.samples[5][0], SampleState::filled);
  EXPECT_EQ(frame_tag(five, 5, 0), tag(0, 104));
  EXPECT_EQ(frame_tag(five, 5, 1), tag(1, 105));
  EXPECT_FLOAT_EQ(five.receivers[0].missing_ratio, 0.05F);
  const Window& six = windows.at(6);
  EXPECT_TRUE(six.links.all());
  EXPECT_EQ(frame_tag(six, 10, 0), tag(0, 129));
  EXPECT_EQ(frame_tag(six, 11, 0), tag(0, 129));
  const Window& ten = windows.at(10);
  EXPECT_EQ(ten.links, LinkSet(0x1C7));
  EXPECT_EQ(ten.samples[10][1], SampleState::filled);
  EXPECT_EQ(ten.samples[12][1], SampleState::missing);
  EXPECT_EQ(frame_tag(ten, 0, 1), 0);
  EXPECT_EQ(front_end.stats().receivers[0].filled, 3U);
  EXPECT_EQ(front_end.stats().windows_masked, 1U);
}

TEST(FrontEnd, APauseMovesSlotsOnByTheTimeThatPassed) {
  auto transmitter = csip_transmitter();
  transmitter.pause_s = [](std::int64_t frame) { return frame == 300 ? 2.0 : 0.0; };
  FrontEnd front_end({});
  const auto windows = run(front_end, make_packets(transmitter, three_receivers()));
  EXPECT_EQ(front_end.stats().pauses, 1U);
  EXPECT_NEAR(static_cast<double>(front_end.newest_slot()), 599 + 600, 1);
  const std::int64_t moved = front_end.newest_slot() - 599;
  for (const Window& window : windows)
    for (std::size_t t = 0; t < kSamples; ++t) {
      const std::int64_t slot = slot_of(window, t);
      const bool before = slot < 300, after = slot >= 300 + moved;
      const SampleState state = window.samples[t][0];
      EXPECT_EQ(state == SampleState::received, before || after) << slot;
      if (state == SampleState::received && window.links[0]) {
        EXPECT_EQ(frame_tag(window, t, 0), tag(0, before ? slot : slot - moved)) << slot;
      }
    }
}

TEST(FrontEnd, ATransmitterThatStartsAnewIsFollowed) {
  auto transmitter = csip_transmitter();
  transmitter.frame_record = [](std::int64_t f) {
    return f < 300 ? csip_frame(50'000 + static_cast<std::uint64_t>(f))
                   : csip_frame(static_cast<std::uint64_t>(f - 300), 2);
  };
  FrontEnd front_end({});
  const auto windows = run(front_end, make_packets(transmitter, three_receivers()));
  EXPECT_EQ(front_end.stats().restarts, 1U);
  EXPECT_EQ(total(front_end, &ReceiverStats::unplaced), 7U);
  EXPECT_NEAR(static_cast<double>(front_end.newest_slot()), 599, 2);
  const std::int64_t shift = front_end.newest_slot() - 599;
  for (const Window& window : windows)
    if (window.end_slot - 19 > 305) expect_whole({window}, [&](std::int64_t slot) { return slot - shift; });
}

TEST(FrontEnd, OneReceiverThatLiesDoesNotMoveTheLine) {
  auto packets = make_packets(csip_transmitter(), three_receivers());
  for (auto& packet : packets)
    if (packet.receiver == 2 && packet.truth >= 100) {
      const auto frame = csip_frame(7'000'000 + static_cast<std::uint64_t>(packet.truth));
      std::copy(frame.begin(), frame.end(), packet.bytes.begin());
    }
  FrontEnd front_end({});
  const auto windows = run(front_end, packets);
  EXPECT_EQ(front_end.stats().restarts, 0U);
  EXPECT_EQ(front_end.stats().receivers[2].unplaced, 500U);
  EXPECT_EQ(windows.size(), 59U);
  EXPECT_EQ(windows.back().links, LinkSet(0x03F));
}

TEST(FrontEnd, WithoutCountersTimeAligns) {
  auto transmitter = csip_transmitter();
  transmitter.frame_record = testing::no_frame;
  transmitter.access_jitter_us = 26;  // measured on a real transmitter
  auto receivers = three_receivers();
  for (auto& receiver : receivers) receiver.loss = 0.02;
  const auto packets = make_packets(transmitter, receivers);
  FrontEnd front_end({.hop = 20, .max_gap = 20});
  const auto windows = run(front_end, packets, std::chrono::milliseconds(200));
  std::size_t received = 0;
  for (const Window& window : windows)
    for (std::size_t t = 0; t < kSamples; ++t)
      for (std::uint8_t r = 0; r < kReceivers; ++r) {
        if (window.samples[t][r] != SampleState::received) continue;
        ++received;
        if (!window.links[3 * r]) continue;
        ASSERT_EQ(frame_tag(window, t, r), tag(r, slot_of(window, t)));
      }
  EXPECT_EQ(received, packets.size());
  EXPECT_NEAR(front_end.stats().receivers[1].skew_ppm - front_end.stats().receivers[0].skew_ppm, -18.1, 1);
}

TEST(FrontEnd, TheJitterOfChannelAccessTellsWholePacketsOfDifferentPaths) {
  auto transmitter = csip_transmitter();
  transmitter.frame_record = testing::no_frame;
  transmitter.access_jitter_us = 26;
  auto receivers = three_receivers();
  receivers[1].path_ms = 9;  // 2.7 packets
  FrontEnd front_end({});
  expect_whole(run(front_end, make_packets(transmitter, receivers), std::chrono::milliseconds(200)), same);
}

TEST(FrontEnd, AReceiverWithoutCountersIsPlacedByTimeAmongTheOthers) {
  auto packets = make_packets(csip_transmitter(), three_receivers());
  for (auto& packet : packets)
    if (packet.receiver == 1)
      packet.bytes.erase(packet.bytes.begin(), packet.bytes.begin() + kCsipRecordBytes);
  FrontEnd front_end({});
  expect_whole(run(front_end, packets, std::chrono::milliseconds(200)), same);
  EXPECT_EQ(total(front_end, &ReceiverStats::no_counter), 0U);
}

TEST(FrontEnd, ByTimeAReceiverRecoversFromSilenceAndFromAStepOfItsClock) {
  auto transmitter = csip_transmitter(300, 3000);
  transmitter.frame_record = testing::no_frame;
  transmitter.access_jitter_us = 26;
  auto receivers = three_receivers();
  receivers[0].deaf = [](std::int64_t frame) {
    return frame >= 600 && frame < 1500;
  };  // the reference, at that
  auto packets = make_packets(transmitter, receivers);
  for (auto& packet : packets)
    if (packet.receiver == 2 && packet.truth >= 2000) {
      const std::size_t timestamp = packet.bytes.size() - 215 + 3;
      store_le(&packet.bytes[timestamp], load_le<std::uint32_t>(&packet.bytes[timestamp]) - 5'000'000);
    }
  FrontEnd front_end({});
  const auto windows = run(front_end, packets, std::chrono::milliseconds(200));
  for (const Window& window : windows) {
    const bool silent = window.end_slot >= 600 && window.end_slot - 19 < 1500;
    if (!silent) {
      expect_whole({window}, same);
    } else if (window.end_slot >= 602) {
      EXPECT_EQ(window.links, LinkSet(0x1F8));
    }
  }
  EXPECT_EQ(front_end.stats().receivers[2].clock_epochs, 1U);
}

TEST(FrontEnd, AFrozenClockWithoutCountersIsPlacedByArrivalOnlyWhenSlow) {
  auto receivers = three_receivers();
  for (auto& receiver : receivers) receiver.skew_ppm = -1e6;
  auto transmitter = csip_transmitter(20, 200);
  transmitter.frame_record = testing::no_frame;
  FrontEnd slow({.grid_hz = 20, .tx_hz = 20});
  EXPECT_GT(run(slow, make_packets(transmitter, receivers)).size(), 10U);
  EXPECT_GT(slow.newest_slot(), 150);
  transmitter.hz = 300;
  FrontEnd fast({.tx_hz = 300});
  run(fast, make_packets(transmitter, receivers));
  EXPECT_LT(fast.newest_slot(), 10);
  EXPECT_EQ(total(fast, &ReceiverStats::no_counter), 3U * (200 - 64));  // the newest are still held
}

TEST(FrontEnd, TheTickIsSteadyUnderJitterAndFollowsADriftingTransmitter) {
  auto transmitter = csip_transmitter(297.6, 3000);  // 0.8 % below the grid, hence taken for it
  auto receivers = three_receivers();
  for (auto& receiver : receivers) receiver.jitter_ms = 0.25;
  auto packets = make_packets(transmitter, receivers);
  FrontEnd front_end({});
  std::vector<WindowDue> dues;
  Window window;
  for (const auto& packet : packets) {
    while (front_end.next() &&
           packet.arrival > front_end.next()->last_sample + std::chrono::milliseconds(15)) {
      dues.push_back(*front_end.next());
      front_end.take(window);
    }
    front_end.add(packet.packet());
  }
  ASSERT_GT(dues.size(), 280U);
  for (std::size_t i = 1; i < dues.size(); ++i) {
    const double true_s =
        100 + static_cast<double>(dues[i].end_slot) / 297.6 + 0.2e-3;  // and the shortest path
    EXPECT_NEAR(seconds(dues[i].last_sample.time_since_epoch()), true_s, 100e-6) << i;
    EXPECT_GT(dues[i].last_sample, dues[i - 1].last_sample);
  }
}

TEST(FrontEnd, GoesOnTickingWhenNothingComes) {
  FrontEnd front_end({});
  run(front_end, make_packets(csip_transmitter(), three_receivers()));
  const SteadyTime before = front_end.next()->last_sample;
  Window window;
  for (int i = 0; i < 300; ++i) front_end.take(window);
  EXPECT_NEAR(seconds(front_end.next()->last_sample - before), 10, 0.002);
  EXPECT_TRUE(window.links.none());
  EXPECT_EQ(window.receivers[0].rate_hz, 0);
  EXPECT_TRUE(std::isnan(window.receivers[0].rssi_dbm[0]));
}

TEST(FrontEnd, SkipsWindowsOfThePast) {
  FrontEnd front_end({});
  EXPECT_EQ(front_end.skip_before(SteadyTime{}), 0U);
  for (const auto& packet : make_packets(csip_transmitter(), three_receivers()))
    front_end.add(packet.packet());
  const WindowDue first = *front_end.next();
  EXPECT_EQ(front_end.skip_before(first.last_sample), 0U);
  EXPECT_EQ(front_end.skip_before(first.last_sample + std::chrono::milliseconds(100)), 3U);
  EXPECT_EQ(front_end.next()->end_slot, first.end_slot + 30);
  EXPECT_EQ(front_end.skip_before(first.last_sample + std::chrono::milliseconds(101)), 1U);
}

TEST(FrontEnd, WidthsDoNotMix) {
  auto packets = make_packets(csip_transmitter(), three_receivers());
  for (auto& packet : packets)
    if (packet.receiver == 1 && packet.truth >= 300) packet.bytes[packet.bytes.size() - 215 + 3 + 19] |= 0x08;
  FrontEnd front_end({});
  for (const Window& window : run(front_end, packets)) {
    const bool mixed = window.end_slot >= 300;
    EXPECT_EQ((window.reasons & kMixedWidth) != 0, mixed);
    if (window.end_slot >= 303) {
      EXPECT_EQ(window.links, LinkSet(0x1C7));
    }
  }
}

TEST(FrontEnd, WhatCannotBeScaledIsMaskedAndSaysSo) {
  auto packets = make_packets(csip_transmitter(), three_receivers());
  for (auto& packet : packets)
    if (packet.receiver == 1 && packet.truth >= 300 && packet.truth < 340)
      for (std::size_t i = 0; i < 3; ++i) packet.bytes[packet.bytes.size() - 215 + 3 + 10 + i] = 0;  // RSSI
  FrontEnd front_end({.amplitude = AmplitudeMethod::scaled});
  for (const Window& window : run(front_end, packets)) {
    const bool touches = window.end_slot >= 302 && window.end_slot - 19 < 340;
    if (touches) {
      EXPECT_EQ(window.links, LinkSet(0x1C7));
    }
    EXPECT_EQ((window.reasons & kNotFinite) != 0, window.end_slot >= 300 && window.end_slot - 19 < 340);
    for (const float x : window.x) ASSERT_TRUE(std::isfinite(x));
  }
}

TEST(FrontEnd, SaysWhenSamplesOfOneInstantLieFarApart) {
  auto receivers = three_receivers();
  receivers[2].path_ms = 26;
  FrontEnd front_end({.max_skew = std::chrono::milliseconds(20)});
  const auto windows =
      run(front_end, make_packets(csip_transmitter(), receivers), std::chrono::milliseconds(60));
  EXPECT_EQ(windows.back().reasons, kSkew);
  EXPECT_TRUE(windows.back().links.all());
}

TEST(FrontEnd, ChainsStayInTheirOrderWhenAskedTo) {
  auto transmitter = csip_transmitter(300, 60);
  auto packets = make_packets(transmitter, three_receivers());
  for (auto& packet :
       packets) {  // chains now belong to antennas C, A, B; antenna A gets another subcarrier 1
    CsiRecord csi = testing::made_up_csi(packet.receiver, packet.truth);
    csi.antenna_sel = 0x12;
    csi.timestamp_low = static_cast<std::uint32_t>(packet.truth * 3333);
    csi.bfee_count = static_cast<std::uint16_t>(packet.truth);
    for (std::size_t a = 0; a < kAntennas; ++a)
      csi.csi[CsiRecord::index(0, a, 0)] = static_cast<std::int8_t>(10 + a);
    packet.bytes.resize(kCsipRecordBytes);
    append_bfee_record(csi, packet.bytes);
  }
  for (const bool undo : {true, false}) {
    FrontEnd front_end({.undo_permutation = undo});
    const auto windows = run(front_end, packets);
    ASSERT_GT(windows.size(), 3U);
    const std::array<float, 3> expected =
        undo ? std::array<float, 3>{10, 11, 12} : std::array<float, 3>{12, 10, 11};
    for (std::size_t a = 0; a < kAntennas; ++a)
      EXPECT_EQ(windows[0].x[Window::index(0, 7, 3 + a)], expected[a]) << undo << a;
  }
}

TEST(FrontEnd, DamagedAndForeignRecordsAreCountedAndPassedOver) {
  auto packets = make_packets(csip_transmitter(), three_receivers());
  const auto lone_frame = csip_frame(5);
  auto damaged = csip_frame(6);
  damaged[30] ^= 1;
  std::vector<StoredPacket> more;
  for (const auto& packet : packets) {
    if (packet.truth == 100) more.push_back({packet.receiver, packet.arrival, lone_frame, -1});
    if (packet.truth == 200) more.push_back({packet.receiver, packet.arrival, {0, 5, 0xD0, 1, 2, 3, 4}, -1});
    if (packet.truth == 300) more.push_back({packet.receiver, packet.arrival, {0, 9, 0xBB, 1}, -1});
    more.push_back(packet);
    if (packet.truth == 400) std::copy(damaged.begin(), damaged.end(), more.back().bytes.begin());
  }
  FrontEnd front_end({});
  expect_whole(run(front_end, more), same);  // the damaged counters were told by time
  EXPECT_EQ(total(front_end, &ReceiverStats::unpaired_frames), 3U);
  EXPECT_EQ(total(front_end, &ReceiverStats::bad_fcs), 3U);
  EXPECT_EQ(front_end.stats().receivers[0].faults[static_cast<std::size_t>(RecordFault::truncated)], 1U);
}

TEST(FrontEnd, AFrameAndItsCsiMayComeInTwoPackets) {
  std::vector<StoredPacket> split;
  for (const auto& packet : make_packets(csip_transmitter(), three_receivers())) {
    const auto middle = packet.bytes.begin() + kCsipRecordBytes;
    split.push_back({packet.receiver, packet.arrival, {packet.bytes.begin(), middle}, packet.truth});
    split.push_back({packet.receiver, packet.arrival, {middle, packet.bytes.end()}, packet.truth});
  }
  FrontEnd front_end({});
  expect_whole(run(front_end, split), same);
}

TEST(FrontEnd, TheSamePacketsGiveTheSameBits) {
  auto receivers = three_receivers();
  for (auto& receiver : receivers) receiver.loss = 0.05;
  auto transmitter = csip_transmitter();
  for (const bool by_counter : {true, false}) {
    if (!by_counter) transmitter.frame_record = testing::no_frame;
    const auto packets = make_packets(transmitter, receivers);
    FrontEnd first({}), second({});
    const auto a = run(first, packets), b = run(second, packets);
    ASSERT_EQ(a.size(), b.size());
    for (std::size_t i = 0; i < a.size(); ++i) {
      EXPECT_EQ(std::memcmp(a[i].x.data(), b[i].x.data(), sizeof(a[i].x)), 0);
      EXPECT_EQ(a[i].last_sample, b[i].last_sample);
      EXPECT_EQ(a[i].samples, b[i].samples);
    }
  }
}

}  // namespace
}  // namespace csipose
