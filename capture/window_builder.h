// capture/window_builder.h - samples in their slots, windows out: 20 slots of three receivers, filled and
// masked.
//
//   slot        80 81 82 83 ... 98 99
//   receiver 0   x  x  x  x      x  x
//   receiver 1   x  .  x  x      x  x      one lost: repeated from slot 80, if max_gap allows 1
//   receiver 2   x  x  x  .  ..  .  .      dead: its three links are masked, zeros in x
//
// Complex CSI is never blended between frames: each has a random phase of its own.
// Not here: how a frame gets its slot (transmit_line.h).
#pragma once

#include <array>
#include <cstdint>
#include <limits>
#include <vector>

#include "capture/features.h"
#include "proto/window.h"

namespace csipose {

/// What one receiver's frame adds to a window.
struct Sample {
  std::int64_t slot = std::numeric_limits<std::int64_t>::min();
  std::int64_t counter = 0;
  SteadyTime on_air{};
  bool is_40mhz = false;
  bool finite = false;                      ///< features hold numbers
  std::array<float, kAntennas> rssi_dbm{};  ///< per antenna, before the card's gain; NaN where not told
  Features features{};
};

class WindowBuilder {
 public:
  struct Config {
    double grid_hz;
    int max_gap;  ///< slots
    Nanoseconds max_skew;
  };
  explicit WindowBuilder(const Config& config);

  /// Keeps a sample in its slot. false: a newer frame of this slot, or a later slot in its place, was there
  /// already.
  bool put(std::uint8_t receiver, const Sample& sample);

  /// Fills x, samples, links, reasons, end_slot and the receivers' rssi_dbm, missing_ratio and last_counter
  /// (0 unless a sample is in the window). The window's other members are not touched.
  ///   cost  some 3 us, no allocation
  void assemble(std::int64_t end_slot, Window& window) const;

 private:
  struct Choice {
    const Sample* sample = nullptr;
    SampleState state = SampleState::missing;
  };

  const Sample* find(std::uint8_t receiver, std::int64_t slot) const;
  bool majority_is_40mhz(std::int64_t end_slot, Window& window) const;
  Choice choose(std::uint8_t receiver, std::int64_t slot, bool is_40mhz, Window& window) const;
  void assemble_receiver(std::uint8_t receiver, std::int64_t end_slot, bool is_40mhz, Window& window) const;
  void judge_skew(std::int64_t end_slot, Window& window) const;

  Config config_;
  std::size_t mask_;                                  // slots in the ring, a power of two, less one
  std::array<std::vector<Sample>, kReceivers> ring_;  // [receiver][slot & mask_]
};

}  // namespace csipose
