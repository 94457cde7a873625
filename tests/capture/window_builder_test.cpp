#include "capture/window_builder.h"

#include <gtest/gtest.h>

#include <cmath>

namespace csipose {
namespace {

constexpr WindowBuilder::Config kConfig{
    .grid_hz = 300, .max_gap = 2, .max_skew = std::chrono::milliseconds(20)};

Sample sample(std::int64_t slot, std::int64_t counter, float value) {
  Sample made;
  made.slot = slot;
  made.counter = counter;
  made.on_air = SteadyTime{from_seconds(static_cast<double>(slot) / 300)};
  made.finite = true;
  made.rssi_dbm = {-50, -60, std::nanf("")};
  for (std::size_t c = 0; c < kChannels; ++c)
    for (std::size_t a = 0; a < kAntennas; ++a)
      made.features[c * kAntennas + a] = value + static_cast<float>(1000 * c + 100 * a);
  return made;
}

TEST(WindowBuilder, LaysSamplesOutByChannelTimeAndLink) {
  WindowBuilder builder(kConfig);
  for (std::int64_t slot = 0; slot < 20; ++slot)
    for (std::uint8_t r = 0; r < kReceivers; ++r)
      builder.put(r, sample(slot, slot, static_cast<float>(slot) + 0.1F * r));
  Window window;
  builder.assemble(19, window);
  EXPECT_TRUE(window.links.all());
  EXPECT_EQ(window.reasons, 0);
  for (std::size_t c = 0; c < kChannels; ++c)
    for (std::size_t t = 0; t < kSamples; ++t)
      for (std::size_t l = 0; l < kLinks; ++l)
        ASSERT_EQ(window.x[(c * 20 + t) * 9 + l], static_cast<float>(t) + 0.1F * static_cast<float>(l / 3) +
                                                      static_cast<float>(1000 * c + 100 * (l % 3)));
  EXPECT_EQ(window.receivers[0].last_counter, 19U);
  EXPECT_EQ(window.receivers[0].rssi_dbm[1], -60);
  EXPECT_TRUE(std::isnan(window.receivers[0].rssi_dbm[2]));
}

TEST(WindowBuilder, TheNewestFrameOfASlotWins) {
  WindowBuilder builder({.grid_hz = 300, .max_gap = 19, .max_skew = kConfig.max_skew});
  EXPECT_TRUE(builder.put(0, sample(5, 17, 1)));
  EXPECT_TRUE(builder.put(0, sample(5, 19, 2)));
  EXPECT_FALSE(builder.put(0, sample(5, 18, 3)));
  EXPECT_FALSE(builder.put(0, sample(5, 19, 4)));
  Window window;
  builder.assemble(24, window);
  EXPECT_EQ(window.x[Window::index(0, 0, 0)], 2);
}

TEST(WindowBuilder, WhatIsOlderThanTheRingIsRefusedAndForgotten) {
  WindowBuilder builder(kConfig);  // 2 s at 300/s: 600 slots, in a ring of 1024
  EXPECT_TRUE(builder.put(0, sample(-3, 0, 1)));
  EXPECT_TRUE(builder.put(0, sample(-3 + 1024, 0, 2)));
  EXPECT_FALSE(builder.put(0, sample(-3, 0, 1)));
}

TEST(WindowBuilder, AnEmptyWindowIsZerosAndSaysSo) {
  const WindowBuilder builder(kConfig);
  Window window;
  window.x.fill(7);
  window.links.set();
  builder.assemble(1'000'000, window);
  EXPECT_TRUE(window.links.none());
  EXPECT_EQ(window.reasons, kReceiverMissing | kGap);
  for (const float x : window.x) ASSERT_EQ(x, 0);
  EXPECT_EQ(window.receivers[1].missing_ratio, 1);
  EXPECT_EQ(window.receivers[1].last_counter, 0U);
  EXPECT_TRUE(std::isnan(window.receivers[1].rssi_dbm[0]));
}

TEST(WindowBuilder, TheRarerWidthCountsAsNotThere) {
  WindowBuilder builder(kConfig);
  for (std::int64_t slot = 0; slot < 20; ++slot)
    for (std::uint8_t r = 0; r < kReceivers; ++r) {
      Sample made = sample(slot, slot, static_cast<float>(slot));
      made.is_40mhz = r == 1 && (slot == 7 || slot == 8);
      builder.put(r, made);
    }
  Window window;
  builder.assemble(19, window);
  EXPECT_TRUE(window.links.all());  // two in a row can be filled
  EXPECT_EQ(window.reasons, kMixedWidth | kGap);
  EXPECT_EQ(window.samples[8][1], SampleState::filled);
  EXPECT_EQ(window.x[Window::index(0, 8, 3)], 6);
  EXPECT_FLOAT_EQ(window.receivers[1].missing_ratio, 0.1F);
}

TEST(WindowBuilder, SamplesWithoutNumbersAreFilledOver) {
  WindowBuilder builder(kConfig);
  for (std::int64_t slot = 0; slot < 20; ++slot)
    for (std::uint8_t r = 0; r < kReceivers; ++r) {
      Sample made = sample(slot, slot, static_cast<float>(slot));
      made.finite = r != 2 || slot != 0;
      if (!made.finite) made.features.fill(std::nanf(""));
      builder.put(r, made);
    }
  Window window;
  builder.assemble(19, window);
  EXPECT_EQ(window.links, LinkSet(0x03F));  // nothing older than slot 0 to fill from
  EXPECT_EQ(window.reasons, kNotFinite | kGap | kReceiverMissing);
  for (const float x : window.x) ASSERT_TRUE(std::isfinite(x));
}

}  // namespace
}  // namespace csipose
