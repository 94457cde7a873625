// capture/aligner.h - which frame of one receiver is which frame of another, where the frames do not say so
// themselves; and how well the receivers' clocks agree, for all of them.
//
// All receivers hear a transmitted frame within nanoseconds: an event. The last second of events is kept
// here, each with its counter on the common line (transmit_line.h) and its time on the common axis, which is
// the radio clock of one receiver, the reference; should that fall silent, another carries the axis on.
//
// Frames with a counter find their event by it. A frame without one finds it by time:
//   1. its receiver settles: the shortest paths of NicClock give its clock on the axis to about a
//   millisecond; then the
//      irregular gaps and losses of its first frames, which are the same for all receivers, choose among the
//      shifts by whole packets that are still possible
//   2. from then on matched pairs keep its clock on the axis to a microsecond (pair_line.h), and a frame
//   belongs to the
//      event within that tolerance, or starts an event that is numbered by its distance in time from its
//      neighbours
//
// Sources: the lower edge of delays as in V. Paxson, On calibrating measurements of packet transit times,
// 1998. The rest measured on made-up receivers (tests/capture).
#pragma once

#include <array>
#include <cstdint>
#include <optional>
#include <span>
#include <vector>

#include "capture/nic_clock.h"
#include "capture/pair_line.h"
#include "proto/shape.h"

namespace csipose {

class Aligner {
 public:
  /// So many frames of a receiver without counters are held back until their receiver can settle.
  static constexpr std::size_t kSettleFrames = 32;

  /// What is known of a frame besides its counter.
  struct Frame {
    std::uint8_t receiver = 0;
    NicClock::Reading nic;
    SteadyTime on_air{};  ///< NicClock::on_air()
    SteadyTime arrival{};
  };
  struct ReceiverView {
    double offset_s = 0, skew_ppm = 0, residual_s = 0;  ///< NIC clock against the axis; NaN when not known
    std::uint64_t heard = 0, matched = 0,
                  missed = 0;  ///< events a second old: heard; by others too; not heard
  };

  /// max_error: how far apart two receivers' shortest paths to this host may be.
  explicit Aligner(Nanoseconds max_error);

  /// Notes that a receiver heard the frame with this counter. false: it has heard it before.
  ///   cost  O(1) for frames in order, no allocation
  bool heard(const Frame& frame, std::int64_t counter);

  /// Whether the frame can be placed by time: its receiver has settled, and has not been silent for long
  /// since.
  bool settled(const Frame& frame) const;
  /// Settles a receiver on its frames so far (at least one, ascending in time, one clock epoch).
  ///   period_s  between frames, as they come at present
  void settle(std::span<const Frame> frames, double period_s);
  /// The counter of a frame of a settled receiver; nullopt when there is no event yet to count from, or no
  /// number free.
  std::optional<std::int64_t> counter_by_time(const Frame& frame, double period_s) const;

  ReceiverView view(std::uint8_t receiver) const;
  /// Counts the events that are not yet a second old as well: nothing more will come.
  void finish();

 private:
  static constexpr std::size_t kEvents = 4096;  // a power of two; a second at 4,000 packets a second
  static constexpr std::uint8_t kNobody = 0xFF;

  struct Event {
    std::int64_t counter = 0;
    double axis_us = 0;  // NaN while no clock that is known has heard it
    bool by_reference = false;
    std::uint8_t heard = 0;  // bit per receiver
    SteadyTime arrival{};    // the first
    std::array<NicClock::Reading, kReceivers> nic{};
  };
  struct Clock {
    PairLine line;
    std::uint32_t epoch = 0;
    NicClock::Reading last{};
    SteadyTime last_on_air{}, last_arrival{};
    std::uint64_t heard = 0, matched = 0, missed = 0;
    int alone = 0;  // events in a row that the reference, though alive, did not hear
  };
  struct Shift {
    double offset_us;  // of the frames against the coarse guess
    double spread_us;
    int matches;
  };

  const Event& at(std::size_t i) const { return events_[(first_ + i) % kEvents]; }
  Event& at(std::size_t i) { return events_[(first_ + i) % kEvents]; }
  Event* event_of(std::int64_t counter, SteadyTime arrival);
  void follow_epoch(const Frame& frame);
  void choose_reference(const Frame& frame);
  void start_axis(const Frame& frame);
  void time_event(Event& event, const Frame& frame);
  void pair(std::uint8_t receiver, const Event& event);
  std::optional<double> coarse_axis_us(const Frame& frame) const;
  double tolerance_us(std::uint8_t receiver, double period_us) const;
  std::optional<Shift> best_shift(std::span<const Frame> frames, double coarse_us, double period_us);
  Shift judge(std::span<const Frame> frames, double offset_us, double tolerance_us) const;
  void expire(SteadyTime before);
  void retire(const Event& event);

  double max_error_us_;
  std::vector<Event> events_;  // a ring, ascending in counter and hence in time
  std::size_t first_ = 0, count_ = 0;
  std::vector<double> axis_us_;  // of the events that have one, ascending: scratch of settle()
  std::array<Clock, kReceivers> clocks_;
  std::uint8_t reference_ = kNobody;
  std::int64_t retired_;  // newest counter that has left the ring
};

}  // namespace csipose
