// capture/frame_pairer.h - joins a received frame (0xC1) with the CSI (0xBB) of the same frame that follows
// it.
//
// For carriers that bring records one by one: netlink and csitool's TCP. Other codes are passed over; a frame
// without CSI (legacy rate, beacon) comes out alone when the next frame arrives, so that it can be counted.
// C++17-clean.
#pragma once

#include <vector>

#include "proto/bytes.h"

namespace csipose {

class FramePairer {
 public:
  /// Takes one whole framed record. Returns the records of a packet that is complete now, valid until the
  /// next call, or empty.
  ByteView add(ByteView record);
  /// The frame that still waits for its CSI, or empty.
  ByteView flush();

 private:
  std::vector<std::uint8_t> waiting_,
      given_;  // keep their capacity: no allocation once the largest record has come
};

}  // namespace csipose
