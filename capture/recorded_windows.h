// capture/recorded_windows.h - all windows of a recording, as the daemon would make them live: a window waits for
// stragglers as long as there, and nothing depends on how fast the packets come.
#pragma once

#include <functional>

#include "capture/front_end.h"
#include "capture/source.h"

namespace csipose {

/// How long a window waits for packets that come late, unless somebody says otherwise.
inline constexpr Nanoseconds kUsualJitter = std::chrono::milliseconds(15);

/// Polls `source` to its end and calls `use` with each window of `front_end`, valid during the call.
void for_each_window(PacketSource& source, FrontEnd& front_end, Nanoseconds jitter,
                     const std::function<void(const Window&)>& use);

/// Calls `use` with each packet of `source` to its end.
void for_each_packet(PacketSource& source, const std::function<void(const Packet&)>& use);

}  // namespace csipose
