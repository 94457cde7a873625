#include "daemon/realtime.h"

#include <fmt/format.h>
#include <sched.h>
#include <sys/mman.h>
#include <sys/prctl.h>
#include <sys/timex.h>
#include <time.h>

#include <cerrno>
#include <cstring>

namespace csipose {
namespace {

std::int64_t read_clock(clockid_t clock) {
  timespec time{};
  clock_gettime(clock, &time);
  return std::int64_t{time.tv_sec} * 1'000'000'000 + time.tv_nsec;
}

}  // namespace

SteadyTime MonotonicClock::now() { return SteadyTime{Nanoseconds{read_clock(CLOCK_MONOTONIC)}}; }
UtcTime MonotonicClock::utc_now() { return UtcTime{Nanoseconds{read_clock(CLOCK_REALTIME)}}; }

void MonotonicClock::sleep_until(SteadyTime instant) {
  const std::int64_t at = ns(instant);
  const timespec time{.tv_sec = at / 1'000'000'000, .tv_nsec = at % 1'000'000'000};
  while (clock_nanosleep(CLOCK_MONOTONIC, TIMER_ABSTIME, &time, nullptr) == EINTR) {
  }
}

Refusal pin_this_thread(int cpu) {
  cpu_set_t set;
  CPU_ZERO(&set);
  CPU_SET(static_cast<std::size_t>(cpu), &set);
  if (sched_setaffinity(0, sizeof set, &set) == 0) return std::nullopt;
  return fmt::format(
      "not pinned to processor {}: {}; loop.cpu_affinity must name processors that this process may use", cpu,
      std::strerror(errno));
}

Refusal run_with_realtime_priority(int priority) {
  sched_param parameters{};
  parameters.sched_priority = priority;
  if (sched_setscheduler(0, SCHED_FIFO, &parameters) == 0) return std::nullopt;
  return fmt::format(
      "no real-time priority {}: {}; the unit needs LimitRTPRIO, or set loop.realtime_priority = 0", priority,
      std::strerror(errno));
}

Refusal lock_all_memory() {
  if (mlockall(MCL_CURRENT | MCL_FUTURE) == 0) return std::nullopt;
  return fmt::format(
      "memory is not locked: {}; the unit needs LimitMEMLOCK=infinity, or set loop.lock_memory = false",
      std::strerror(errno));
}

void use_precise_timers() { prctl(PR_SET_TIMERSLACK, 1UL); }

std::uint64_t clock_error_ns() {
  timex state{};
  const int result = adjtimex(&state);
  if (result < 0 || result == TIME_ERROR || (state.status & STA_UNSYNC) != 0) return 0;
  return static_cast<std::uint64_t>(state.maxerror) * 1000;
}

}  // namespace csipose
