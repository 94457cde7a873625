// proto/packet.h - what one receiver reports of one received frame, as bytes, and when it came.
//
// Every source (netlink, UDP, TCP, recording, .dat file, simulator) gives Packets, and nothing else enters the program.
#pragma once

#include <cstdint>

#include "proto/bytes.h"
#include "proto/time.h"

namespace csipose {

struct Packet {
  std::uint8_t receiver = 0;  ///< index in configured order, 0..kReceivers-1
  SteadyTime arrival{};       ///< when it reached this process; recorded time in a replay
  UtcTime arrival_utc{};      ///< the same instant for people
  /// Whole records in csitool framing (be16 length, code, body): at most one 0xC1 (the frame) and then at most one
  /// 0xBB (its CSI). Not yet checked: what lies inside the records may be anything.
  ByteView records;
};

}  // namespace csipose
