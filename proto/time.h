// proto/time.h - the two clocks of the project.
//
// Steady time orders and paces (CLOCK_MONOTONIC when live; in a replay and in a simulation, time as it was recorded).
// UTC is for people and other machines: it labels, it never paces.
#pragma once

#include <chrono>
#include <cstdint>

namespace csipose {

using Nanoseconds = std::chrono::nanoseconds;
using SteadyTime = std::chrono::time_point<std::chrono::steady_clock, Nanoseconds>;
using UtcTime = std::chrono::time_point<std::chrono::system_clock, Nanoseconds>;

inline SteadyTime steady_now() { return std::chrono::steady_clock::now(); }
inline UtcTime utc_now() { return std::chrono::system_clock::now(); }

inline std::int64_t ns(Nanoseconds d) { return d.count(); }
inline std::int64_t ns(SteadyTime t) { return t.time_since_epoch().count(); }
inline std::int64_t ns(UtcTime t) { return t.time_since_epoch().count(); }
inline double seconds(Nanoseconds d) { return static_cast<double>(d.count()) * 1e-9; }
inline Nanoseconds from_seconds(double s) { return Nanoseconds{static_cast<std::int64_t>(s * 1e9)}; }

}  // namespace csipose
