// proto/notify.h - tells systemd how we are, by writing to its socket; nothing when systemd did not
// start us.
#pragma once

#include <string>

#include "proto/time.h"

namespace csipose {

/// One or more lines of the sd_notify protocol: "READY=1", "STATUS=...", "WATCHDOG=1".
void notify_systemd(const std::string& lines);
/// How often systemd wants to hear WATCHDOG=1 at least; 0 = it does not care.
Nanoseconds watchdog_interval();

}  // namespace csipose
