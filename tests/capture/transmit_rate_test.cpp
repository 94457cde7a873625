#include "capture/transmit_rate.h"

#include <gtest/gtest.h>

#include <limits>
#include <vector>

namespace csipose {
namespace {

std::vector<TimedCounter> counted(double hz, std::uint64_t first, std::uint64_t modulus) {
  std::vector<TimedCounter> frames;
  for (std::uint64_t i = 0; frames.size() < kRateFrames; ++i)
    if (i % 5 != 3)
      frames.push_back({static_cast<double>(i) / hz, modulus == 0 ? first + i : (first + i) % modulus});
  return frames;
}

TEST(TransmitRate, ByCounterThroughLossesAndWraps) {
  EXPECT_NEAR(*transmit_rate_hz(counted(300, 0, 0), 0), 300, 1e-6);
  EXPECT_NEAR(*transmit_rate_hz(counted(1000, 65'530, 65'536), 65'536), 1000, 1e-6);
  EXPECT_NEAR(*transmit_rate_hz(counted(10, 4090, 4096), 4096), 10, 1e-6);
  EXPECT_NEAR(*transmit_rate_hz(counted(300, ~std::uint64_t{0} - 10, 0), 0), 300, 1e-6);
}

TEST(TransmitRate, ByCounterAPauseIsLeftOut) {
  auto frames = counted(300, 0, 0);
  for (std::size_t i = 28; i < frames.size(); ++i) frames[i].time_s += 2;
  EXPECT_NEAR(*transmit_rate_hz(frames, 0), 300, 1e-6);
}

TEST(TransmitRate, ByTimeThroughLossesAndPauses) {
  std::vector<double> times_s;
  for (int i = 0; times_s.size() < kRateFrames; ++i)
    if (i % 4 != 1) times_s.push_back(i / 300.0 + (i > 30 ? 5.0 : 0.0) + (i % 2) * 20e-6);
  EXPECT_NEAR(*transmit_rate_hz(times_s), 300, 0.5);
}

TEST(TransmitRate, WhatNoTransmitterDoesIsRefused) {
  const std::vector<TimedCounter> still(kRateFrames, TimedCounter{1, 7});
  EXPECT_FALSE(transmit_rate_hz(still, 0));
  std::vector<TimedCounter> back, fast;
  for (std::size_t i = 0; i < kRateFrames; ++i) {
    back.push_back({static_cast<double>(i), 1000 - i});
    fast.push_back({static_cast<double>(i) * 1e-6, i});
  }
  EXPECT_FALSE(transmit_rate_hz(back, 0));
  EXPECT_FALSE(transmit_rate_hz(fast, 0));
  EXPECT_FALSE(transmit_rate_hz(std::vector<double>(kRateFrames, 3.0)));
}

}  // namespace
}  // namespace csipose
