#include "capture/transmit_line.h"

#include <gtest/gtest.h>

#include <cmath>

#include "tests/capture/moments.h"

namespace csipose {
namespace {

using testing::at;

/// A transmitter of 300 frames a second since t = 100 s, whose counter begins at `first` and wraps at
/// `modulus`.
struct CountingSender {
  std::uint64_t first = 0, modulus = 0;
  TxCounter counter(std::int64_t frame) const {
    const std::uint64_t value = first + static_cast<std::uint64_t>(frame);
    return {.value = modulus == 0 ? value : value % modulus, .modulus = modulus};
  }
  static double time_s(std::int64_t frame) { return 100 + static_cast<double>(frame) / 300; }
};

/// Places a frame and tells of its arrival; the slot, or -1000 where it contradicts the line.
std::int64_t place(TransmitLine& line, TxCounter counter, double time_s) {
  const auto placed = line.place(counter, at(time_s));
  if (!placed) return -1000;
  line.arrived(*placed, at(time_s));
  return line.slot_of(*placed);
}

TransmitLine started(const CountingSender& sender) {
  TransmitLine line(300);
  line.start(sender.counter(0), 300, 300, at(CountingSender::time_s(0)));
  return line;
}

class TransmitLineWraps : public ::testing::TestWithParam<CountingSender> {};

TEST_P(TransmitLineWraps, CountsOnThroughWrapsLossesAndSilence) {
  TransmitLine line = started(GetParam());
  for (std::int64_t frame = 0; frame < 30'000; ++frame) {
    if (frame % 7 == 3 || (frame > 2000 && frame < 8000)) continue;  // nobody is heard for 20 s
    ASSERT_EQ(place(line, GetParam().counter(frame), CountingSender::time_s(frame)), frame);
  }
  EXPECT_EQ(line.pauses() + line.restarts(), 0U);
  EXPECT_EQ(line.newest_slot(), 29'999);
  EXPECT_NEAR(seconds(line.time_of(30'300).time_since_epoch()), CountingSender::time_s(30'300), 1e-6);
  EXPECT_EQ(line.first_slot_from(at(CountingSender::time_s(30'300) + 1e-4)), 30'301);
}

INSTANTIATE_TEST_SUITE_P(, TransmitLineWraps,
                         ::testing::Values(CountingSender{0, 0}, CountingSender{~std::uint64_t{0} - 1000, 0},
                                           CountingSender{65'000, 65'536}, CountingSender{4000, 4096},
                                           CountingSender{19'000, 20'000}, CountingSender{12, 2'000'000}));

TEST(TransmitLine, OldFramesFindTheirPlaceLate) {
  const CountingSender sender{.first = 100, .modulus = 4096};
  TransmitLine line = started(sender);
  for (std::int64_t frame = 0; frame < 900; ++frame)
    place(line, sender.counter(frame), CountingSender::time_s(frame));
  EXPECT_EQ(place(line, sender.counter(800), CountingSender::time_s(899)), 800);
  EXPECT_EQ(place(line, sender.counter(400), CountingSender::time_s(899)), 400);
  EXPECT_EQ(place(line, sender.counter(-5), CountingSender::time_s(3)), -5);
}

TEST(TransmitLine, SlotsOfUnequalRates) {
  TransmitLine line(300);
  line.start({.value = 10}, 1000, 1000, at(100));
  const std::array<std::int64_t, 11> slots{0, 0, 0, 0, 1, 1, 1, 2, 2, 2, 3};  // floor(0.3 n)
  for (std::size_t i = 0; i < slots.size(); ++i)
    EXPECT_EQ(line.slot_of(10 + static_cast<std::int64_t>(i)), slots[i]) << i;
  EXPECT_EQ(line.slot_of(9), -1);
}

TEST(TransmitLine, APauseMovesTheSlotsOnAndKeepsTheCounters) {
  for (const std::uint64_t modulus : {0U, 4096U, 65'536U}) {
    const CountingSender sender{.first = 60, .modulus = modulus};
    TransmitLine line = started(sender);
    for (std::int64_t frame = 0; frame < 600; ++frame)
      place(line, sender.counter(frame), CountingSender::time_s(frame));
    for (std::int64_t frame = 600; frame < 900; ++frame) {
      const std::int64_t slot = place(line, sender.counter(frame), CountingSender::time_s(frame) + 5);
      EXPECT_NEAR(static_cast<double>(slot), static_cast<double>(frame + 1500), 1) << modulus << " " << frame;
    }
    EXPECT_EQ(line.pauses(), 1U) << modulus;
    EXPECT_EQ(place(line, sender.counter(599), CountingSender::time_s(600) + 0.2),
              599);  // a straggler from before
  }
}

TEST(TransmitLine, OneReceiverAloneDoesNotRestartIt) {
  const CountingSender sender;
  TransmitLine line = started(sender);
  for (std::int64_t frame = 0; frame < 600; ++frame) {
    place(line, sender.counter(frame), CountingSender::time_s(frame));
    EXPECT_EQ(
        place(line, {.value = static_cast<std::uint64_t>(90'000 + frame)}, CountingSender::time_s(frame)),
        -1000);
  }
  EXPECT_EQ(line.restarts(), 0U);
}

TEST(TransmitLine, ARestartOfTheTransmitterIsFollowedAfterEightFrames) {
  for (const std::uint64_t modulus : {0U, 20'000U}) {
    const CountingSender before{.first = 9000, .modulus = modulus}, after{.first = 0, .modulus = modulus};
    TransmitLine line = started(before);
    for (std::int64_t frame = 0; frame < 600; ++frame)
      place(line, before.counter(frame), CountingSender::time_s(frame));
    int refused = 0;
    for (std::int64_t frame = 600; frame < 900; ++frame) {
      const std::int64_t slot = place(line, after.counter(frame - 600), CountingSender::time_s(frame));
      refused += slot == -1000;
      if (slot != -1000) {
        EXPECT_NEAR(static_cast<double>(slot), static_cast<double>(frame), 1);
      }
    }
    EXPECT_EQ(refused, TransmitLine::kRestartFrames - 1);
    EXPECT_EQ(line.restarts(), 1U);
  }
}

TEST(TransmitLine, ADamagedCounterIsRefusedOnce) {
  const CountingSender sender;
  TransmitLine line = started(sender);
  for (std::int64_t frame = 0; frame < 300; ++frame)
    place(line, sender.counter(frame), CountingSender::time_s(frame));
  for (const std::uint64_t wrong :
       {~std::uint64_t{0} - 10'000, std::uint64_t{1} << 63, std::uint64_t{1} << 40, std::uint64_t{100'000}})
    EXPECT_EQ(place(line, {.value = wrong}, CountingSender::time_s(300)), -1000) << wrong;
  EXPECT_EQ(place(line, sender.counter(300), CountingSender::time_s(300)), 300);
}

TEST(TransmitLine, FollowsARateThatIsNearlyTheGrids) {
  TransmitLine line(300);
  line.start({}, 300, 296, at(100));  // taken for 300: every frame has its slot, but slots are longer
  for (std::int64_t frame = 0; frame < 3000; ++frame)
    ASSERT_EQ(
        place(line, {.value = static_cast<std::uint64_t>(frame)}, 100 + static_cast<double>(frame) / 295),
        frame);
  EXPECT_NEAR(1 / line.counter_period_s(), 295, 0.01);
  EXPECT_EQ(line.pauses() + line.restarts(), 0U);
}

}  // namespace
}  // namespace csipose
