// tests/capture/moments.h - moments by the seconds since the clock's epoch.
#pragma once

#include "proto/time.h"

namespace csipose::testing {

inline SteadyTime at(double s) { return SteadyTime{from_seconds(s)}; }

}  // namespace csipose::testing
