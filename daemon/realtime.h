// daemon/realtime.h - what the loop's thread asks of the kernel, and the clock it sleeps on.
//
// Every request may be refused; each answers with words for the log, and the daemon goes on without.
#pragma once

#include <optional>
#include <string>

#include "proto/time.h"

namespace csipose {

/// Time as the loop sees it. Tests give their own.
class LoopClock {
 public:
  virtual ~LoopClock() = default;
  virtual SteadyTime now() = 0;
  virtual UtcTime utc_now() = 0;
  virtual void sleep_until(SteadyTime instant) = 0;
};

/// CLOCK_MONOTONIC, absolute sleeps: a late wake-up does not shift the next one.
class MonotonicClock final : public LoopClock {
 public:
  SteadyTime now() override;
  UtcTime utc_now() override;
  void sleep_until(SteadyTime instant) override;
};

/// Why a request was refused and what to do; nullopt = granted.
using Refusal = std::optional<std::string>;

/// The calling thread runs on this processor only.
Refusal pin_this_thread(int cpu);
/// The calling thread runs with SCHED_FIFO.
Refusal run_with_realtime_priority(int priority);
/// All pages of the process, present and future, stay resident.
Refusal lock_all_memory();
/// The calling thread's sleeps end within a microsecond of their instant, not 50.
void use_precise_timers();

/// Bound on UTC's error as the kernel's clock state has it; 0 = not synchronised, hence unknown.
std::uint64_t clock_error_ns();

}  // namespace csipose
