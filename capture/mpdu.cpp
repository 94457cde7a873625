#include "capture/mpdu.h"

#include "proto/crc32.h"
#include "proto/frame_record.h"

namespace csipose {
namespace {

constexpr std::uint16_t kToDs = 0x0100, kFromDs = 0x0200, kOrder = 0x8000;
constexpr std::uint16_t kQosData = 0x0088, kTypeAndQosBit = 0x008C;

bool has_valid_fcs(ByteView frame) {
  const std::size_t covered = frame.size() - kFcsBytes;
  return crc32(frame.sub(0, covered)) == load_le<std::uint32_t>(frame.data() + covered);
}

bool is_qos_data(std::uint16_t control) { return (control & kTypeAndQosBit) == kQosData; }

/// Address 4 where both DS bits are set, then QoS control, then HT control where the order bit says so.
std::size_t header_bytes(std::uint16_t control) {
  const bool is_data = (control & 0x000C) == 0x0008, is_management = (control & 0x000C) == 0;
  std::size_t bytes = kDataHeaderBytes;
  if (is_data && (control & kToDs) != 0 && (control & kFromDs) != 0) bytes += 6;
  if (is_qos_data(control)) bytes += 2;
  if ((control & kOrder) != 0 && (is_qos_data(control) || is_management)) bytes += 4;
  return bytes;
}

}  // namespace

Result<Mpdu, MpduFault> parse_mpdu(ByteView frame) {
  if (frame.size() < kDataHeaderBytes + kFcsBytes) return MpduFault::too_short;
  if (!has_valid_fcs(frame)) return MpduFault::bad_fcs;
  Mpdu mpdu;
  mpdu.frame_control = load_le<std::uint16_t>(frame.data());
  mpdu.duration = load_le<std::uint16_t>(frame.data() + 2);
  mpdu.transmitter = frame.sub(10, 6);
  mpdu.sequence_control = load_le<std::uint16_t>(frame.data() + 22);
  const std::size_t header = header_bytes(mpdu.frame_control);
  if (frame.size() < header + kFcsBytes) return MpduFault::too_short;
  mpdu.body = frame.sub(header, frame.size() - header - kFcsBytes);

  const std::size_t qos = (mpdu.frame_control & kToDs) != 0 && (mpdu.frame_control & kFromDs) != 0 ? 30 : 24;
  mpdu.traffic_class = is_qos_data(mpdu.frame_control) ? frame[qos] & 0x0F : Mpdu::kNoTrafficClass;
  return mpdu;
}

}  // namespace csipose
