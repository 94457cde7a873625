// proto/window.h - 20 aligned samples of nine links: what the network eats, and what it must know about it.
#pragma once

#include <array>
#include <bitset>
#include <cstdint>

#include "proto/shape.h"
#include "proto/time.h"

namespace csipose {

/// Which links are there; bit l = 3 * receiver + antenna.
using LinkSet = std::bitset<kLinks>;

/// How one sample of one receiver came about.
enum class SampleState : std::uint8_t {
  missing,  ///< nothing within max_gap: x holds zeros
  filled,   ///< repeated from the nearest older sample, at most max_gap samples old
  received,
};

/// Why a window is less than whole. Bits; each has a counter.
enum WindowReason : std::uint16_t {
  kReceiverMissing = 1 << 0,  ///< a receiver has no link in this window
  kGap = 1 << 1,              ///< some sample was filled or missing
  kSkew = 1 << 2,             ///< receivers' samples of one instant lie further apart than max_skew
  kNotFinite = 1 << 3,        ///< CSI that is not a number was met and masked
  kMixedWidth = 1 << 4,       ///< 20 and 40 MHz in one window: the rarer width was masked
};

/// The state of one receiver during the window.
struct ReceiverQuality {
  float rate_hz = 0;                        ///< usable records a second over the last second
  std::array<float, kAntennas> rssi_dbm{};  ///< mean over the window; NaN when nothing was received
  float missing_ratio = 1;                  ///< samples of the window not received, 0..1
  std::uint64_t last_counter = 0;           ///< newest transmit counter, unwrapped; 0 = none known
};

struct Window {
  /// X[c][t][l], C order: c = 0..29 amplitude of subcarrier c, c = 30..59 sanitised phase of subcarrier c - 30 in
  /// (-pi, pi]; t = 0 oldest; l = 3 * receiver + antenna. Masked entries are 0.
  std::array<float, kChannels * kSamples * kLinks> x{};
  std::array<std::array<SampleState, kReceivers>, kSamples> samples{};  ///< [t][receiver]
  LinkSet links;              ///< links whose 20 samples are all received or filled
  std::uint16_t reasons = 0;  ///< WindowReason bits
  std::int64_t end_slot = 0;  ///< grid index of the newest sample
  SteadyTime last_sample{};   ///< instant of the newest sample on the receiver's clock
  UtcTime first_sample_utc{}, last_sample_utc{};
  std::array<ReceiverQuality, kReceivers> receivers{};

  static constexpr std::size_t index(std::size_t c, std::size_t t, std::size_t l) {
    return (c * kSamples + t) * kLinks + l;
  }
};

}  // namespace csipose
