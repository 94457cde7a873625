// capture/receiver_input.h - one receiver's packets to frames: records paired, decoded, timed and made into
// features.
//
// The driver logs each received 802.11 frame (0xC1) immediately before its CSI (0xBB). A 0xC1 without CSI is
// followed by another one and dropped; anything between the two parts them. Not here: which frame this is
// among those of the other receivers (aligner.h, transmit_line.h).
#pragma once

#include <array>
#include <optional>
#include <vector>

#include "capture/aligner.h"
#include "capture/features.h"
#include "capture/front_end.h"
#include "capture/tx_counter.h"
#include "capture/window_builder.h"
#include "proto/record_stream.h"

namespace csipose {

struct ReceivedFrame {
  Aligner::Frame time;  ///< receiver, clocks
  std::optional<TxCounter> counter;
  bool repeated = false;  ///< bfee_count came before: counted as a duplicate already
  Sample sample;          ///< slot and counter not yet known
};

/// Events per second, over the last one.
class RateMeter {
 public:
  void count(SteadyTime time);
  double rate_hz(SteadyTime now) const;

 private:
  static constexpr std::int64_t kBinsPerSecond = 10;
  static constexpr std::size_t kBins = kBinsPerSecond + 1;  // ten whole ones and the one being filled
  std::array<std::int64_t, kBins> bin_{}, events_{};        // which tenth of a second, and how many in it
};

class ReceiverInput {
 public:
  /// `stats` gets the counters of what is met; it must live as long.
  ReceiverInput(std::uint8_t receiver, const FrontEndConfig& config, ReceiverStats& stats);

  /// Begins a packet that arrived at `arrival`; the bytes must live until the last next().
  void begin(ByteView records, SteadyTime arrival);
  /// The next usable frame of the packet; false: no more. No allocation.
  bool next(ReceivedFrame& frame);

  const NicClock& clock() const { return clock_; }
  double rate_hz(SteadyTime now) const { return meter_.rate_hz(now); }

 private:
  void hold_frame(ByteView frame);
  void drop_held_frame();
  bool read_csi(ByteView body, ReceivedFrame& frame);
  std::optional<TxCounter> counter_of_held_frame();
  int follow_bfee_count(std::uint16_t bfee_count);
  void count_faults();

  std::uint8_t receiver_;
  FeatureOptions features_;
  bool undo_permutation_;
  ReceiverStats& stats_;
  CounterRecovery recovery_;
  NicClock clock_;
  RateMeter meter_;
  RecordStream stream_;
  SteadyTime arrival_{};
  CsiRecord record_;
  std::vector<std::uint8_t> held_;  // a 0xC1 that waits for its CSI; its memory is made once
  bool holding_ = false;
  bool counted_ = false;  // bfee_count_ is known
  std::uint16_t bfee_count_ = 0;
};

}  // namespace csipose
