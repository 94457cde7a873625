// capture/transmit_line.h - the one line on which all frames lie: transmit counter -> grid slot -> instant.
//
//   counter   41 42 43 44 45        46 47 48            counters go on through a pause, slots follow the time
//   slot       0  1  2  3  4  . . .  9 10 11
//             |<-- segment -->|     |<-- segment
//
// Counters wrap (65536, 4096, 20,000 ...), transmitters pause and start again from 0, receivers stall, die
// and come back. Each counter is therefore unwrapped against the one expected at the frame's time on the air,
// and held against the line:
//   as expected                              it has its place
//   old, and late                            likewise: the counter says where it belongs
//   new, and later than expected             the transmitter paused; a segment opens, moved on by the time
//   that passed anything else                            it contradicts the line. One receiver may be wrong,
//   or the transmitter has
//                                            started anew: kRestartFrames in a row, with no frame on the line
//                                            between them, open a segment; those before the last are not
//                                            placed
// Not here: where counters come from (tx_counter.h, aligner.h).
#pragma once

#include <cstdint>
#include <optional>

#include "capture/lower_line.h"
#include "capture/tx_counter.h"
#include "proto/time.h"

namespace csipose {

class TransmitLine {
 public:
  static constexpr int kRestartFrames = 8;

  explicit TransmitLine(double grid_hz);

  /// Begins the line: `first` has slot 0.
  ///   tx_hz        what one counter step is worth: slot = floor((counter - first) * grid_hz / tx_hz)
  ///   measured_hz  counters a second as they really come, within 3 % of tx_hz
  void start(TxCounter first, double tx_hz, double measured_hz, SteadyTime on_air);
  bool started() const { return tx_hz_ > 0; }

  /// The frame's place, unwrapped, on a line without jumps back; nullopt when it contradicts the line.
  std::optional<std::int64_t> place(TxCounter raw, SteadyTime on_air);
  /// Likewise for a counter that is already on the line's own numbering.
  std::optional<std::int64_t> place_unwrapped(std::int64_t counter, SteadyTime on_air);
  /// A number for a frame of which only the time is known: the one expected then, and newer than all so far.
  std::int64_t fresh_counter(SteadyTime on_air) const;
  /// Tells the line when a placed frame arrived; the earliest arrivals make its clock.
  void arrived(std::int64_t counter, SteadyTime arrival);

  std::int64_t slot_of(std::int64_t counter) const;
  /// When the frame of this slot arrives at the fastest receiver; extrapolated at will.
  SteadyTime time_of(std::int64_t slot) const;
  /// The first slot that is not before `time`.
  std::int64_t first_slot_from(SteadyTime time) const;

  double tx_hz() const { return tx_hz_; }
  /// Seconds between two counters, as they come at present.
  double counter_period_s() const;
  std::int64_t newest_slot() const { return newest_slot_; }
  std::uint64_t pauses() const { return pauses_; }
  std::uint64_t restarts() const { return restarts_; }

 private:
  struct Segment {
    std::int64_t first_counter = 0;  // its own from here on
    std::int64_t anchor_counter = 0, anchor_slot = 0;
    std::uint64_t shift = 0;  // counter = raw + shift
  };
  /// Frames that contradict the line but not each other.
  struct Dissent {
    int frames = 0;
    TxCounter first;
    SteadyTime on_air{};
  };
  struct Candidate {
    std::int64_t counter;
    double late_s;  // on the air this much after its place on the line
  };

  double position_of(std::int64_t counter, const Segment& segment) const;
  double position_at(SteadyTime time) const;
  double late_s(std::int64_t counter, const Segment& segment, SteadyTime on_air) const;
  std::int64_t expected(const Segment& segment, SteadyTime on_air) const;
  Candidate nearest(TxCounter raw, const Segment& segment, SteadyTime on_air) const;
  bool fits(const Candidate& candidate) const;
  std::optional<std::int64_t> accept(std::int64_t counter);
  std::optional<std::int64_t> resume(std::int64_t counter, std::uint64_t shift, SteadyTime on_air);
  std::optional<std::int64_t> dissent(TxCounter raw, SteadyTime on_air);
  bool continues_dissent(TxCounter raw, SteadyTime on_air) const;

  double grid_hz_, tolerance_s_;
  double tx_hz_ = 0;
  LowerLine slot_ns_;
  Segment now_, before_;
  std::int64_t newest_ = 0, newest_slot_ = -1;
  Dissent dissent_;
  std::uint64_t pauses_ = 0, restarts_ = 0;
};

}  // namespace csipose
