// capture/nic_clock.h - one receiver's radio clock: 32 bits of microseconds made a line without wraps, and
// that line laid on the clock of arrivals.
//
// Measured on real recordings: the counter wraps every 4294.967296 s; an access point's client jumps back 4
// to 7 s now and then, with its access point; some logs hold a constant. So time runs in epochs: after a step
// the clock starts anew and whoever has built on it must start anew too.
#pragma once

#include <cstdint>

#include "capture/lower_line.h"
#include "proto/time.h"

namespace csipose {

class NicClock {
 public:
  /// One record's time. Unwrapped microseconds mean something only within their epoch.
  struct Reading {
    std::int64_t us = 0;
    std::uint32_t epoch = 0;
    bool usable = false;  ///< the clock runs; false once it has shown the same time for 8 records
  };

  NicClock();

  /// Takes one record's timestamp.
  ///   in_order  the driver's counter says that this record was made after the last one: only then a step
  ///   back in time
  ///             is the clock's doing and not a reordered packet's
  Reading read(std::uint32_t timestamp_low, bool in_order, SteadyTime arrival);

  /// When the frame was on the air, by the clock of arrivals and less every delay beyond this receiver's
  /// shortest. For a reading of the present epoch; without a usable clock the arrival itself is all there is.
  SteadyTime on_air(const Reading& reading, SteadyTime arrival) const;

  /// Of the newest record: one frozen clock spoils the records before it that looked well, too.
  bool usable() const;
  std::uint32_t epoch() const { return epoch_; }

 private:
  void begin_epoch(std::uint32_t timestamp_low);
  std::int64_t step_nearest(std::uint32_t timestamp_low, std::int64_t expected_us) const;

  LowerLine host_ns_;  // arrival against NIC time
  bool started_ = false;
  bool moved_ = false;  // within this epoch
  std::uint32_t last_low_ = 0;
  std::int64_t us_ = 0;
  std::uint32_t epoch_ = 0;
  int unchanged_ = 0;  // equal timestamps in a row, less one
  SteadyTime last_arrival_{};
};

}  // namespace csipose
