// capture/mpdu.h - the received 802.11 frame in a 0xC1 record: its header fields, once its check sum holds.
//
//   byte 0        2         4      10     16     22                24
//        control  duration  addr1  addr2  addr3  sequence control  [addr4] [QoS] [HT control]  body  FCS
//
// The driver logs frames before its own CRC check, so nothing of a frame is believed before the FCS holds.
// Source: IEEE 802.11-2012 section 8.2; FCS and order measured on csiread's recordings.
#pragma once

#include <cstdint>
#include <span>

#include "proto/bytes.h"
#include "proto/result.h"

namespace csipose {

enum class MpduFault : std::uint8_t {
  too_short,  ///< smaller than the header of a data frame and the FCS: a control frame, or nothing
  bad_fcs,    ///< damaged on the air
};

struct Mpdu {
  std::uint16_t frame_control = 0;
  std::uint16_t duration = 0;
  std::uint16_t sequence_control = 0;  ///< 12 bits of sequence number over 4 bits of fragment number
  ByteView transmitter;                ///< address 2, 6 bytes
  /// Frames of one transmitter and one traffic class share one sequence counter: the TID of a QoS data frame,
  /// or kNoTrafficClass for all other frames.
  std::uint8_t traffic_class = 0;
  ByteView body;  ///< without headers and FCS

  static constexpr std::uint8_t kNoTrafficClass = 16;
  bool is_data() const { return (frame_control & 0x000C) == 0x0008; }
};

/// Reads the body of a 0xC1 record. The views point into it. No allocation.
Result<Mpdu, MpduFault> parse_mpdu(ByteView frame);

}  // namespace csipose
