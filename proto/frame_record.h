// proto/frame_record.h - writes 0xC1 records: a received 802.11 frame as the driver logs it, FCS included.
//
// And the frame of our own injector, whose body carries the transmit counter, all little-endian:
//
//   "CSIP"  version=1  0  session:2  counter:8  transmit time:8 (ns, sender's monotonic clock)
//
// For generators, simulators and tests. C++17, because the receiver's agent replays logs with it.
// Not here: reading a frame and recovering its counter (capture/mpdu.h, capture/tx_counter.h).
#pragma once

#include <array>
#include <cstdint>
#include <vector>

#include "proto/bytes.h"

namespace csipose {

inline constexpr std::size_t kDataHeaderBytes =
    24;  ///< of an 802.11 data frame without QoS and fourth address
inline constexpr std::size_t kFcsBytes = 4;
inline constexpr std::size_t kCsipBodyBytes = 24;
inline constexpr std::uint8_t kCsipVersion = 1;
inline constexpr std::size_t kCsipRecordBytes = 3 + kDataHeaderBytes + kCsipBodyBytes + kFcsBytes;

/// What our injector says in each frame.
struct CsipBody {
  std::uint16_t session = 0;      ///< drawn anew at each start of the injector
  std::uint64_t counter = 0;      ///< +1 per frame
  std::uint64_t transmit_ns = 0;  ///< injector's monotonic clock
};

/// A data frame's 802.11 header as csitool's injector sends it: both to and from 00:16:ea:12:34:56, for which
/// alone the firmware measures CSI in monitor mode (csitool-supplementary issue 288).
std::array<std::uint8_t, kDataHeaderBytes> injector_header(std::uint16_t sequence_control);

/// The framed record (length, code, frame, FCS) of an 802.11 frame given without its FCS.
/// Requires frame.size() <= 65530, the most that a record can hold.
std::vector<std::uint8_t> encode_frame_record(ByteView frame);

/// The framed record of one frame of our own injector. No allocation.
std::array<std::uint8_t, kCsipRecordBytes> encode_csip_record(const CsipBody& body);

}  // namespace csipose
