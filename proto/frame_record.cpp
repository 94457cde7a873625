#include "proto/frame_record.h"

#include <algorithm>
#include <cassert>

#include "proto/crc32.h"
#include "proto/record_stream.h"

namespace csipose {
namespace {

constexpr std::uint16_t kDataFrame = 0x0008;  // frame control: type data, subtype 0, neither to nor from DS

/// Writes length, code and FCS around a frame that lies at record + 3.
void seal_record(std::uint8_t* record, std::size_t frame_bytes) {
  std::uint8_t* frame = record + kRecordHeaderBytes;
  store_be16(record, static_cast<std::uint16_t>(1 + frame_bytes + kFcsBytes));
  record[2] = kFrameCode;
  store_le(frame + frame_bytes, crc32(ByteView(frame, frame_bytes)));
}

}  // namespace

std::array<std::uint8_t, kDataHeaderBytes> injector_header(std::uint16_t sequence_control) {
  static constexpr std::array<std::uint8_t, 6> kInjectorAddress = {0x00, 0x16, 0xea, 0x12, 0x34, 0x56};
  std::array<std::uint8_t, kDataHeaderBytes> header{};
  store_le(header.data(), kDataFrame);
  std::copy(kInjectorAddress.begin(), kInjectorAddress.end(), header.begin() + 4);
  std::copy(kInjectorAddress.begin(), kInjectorAddress.end(), header.begin() + 10);
  std::fill_n(header.begin() + 16, 6, std::uint8_t{0xff});
  store_le(header.data() + 22, sequence_control);
  return header;
}

std::vector<std::uint8_t> encode_frame_record(ByteView frame) {
  assert(frame.size() <= 65535 - 1 - kFcsBytes);
  std::vector<std::uint8_t> record(kRecordHeaderBytes + frame.size() + kFcsBytes);
  std::copy(frame.begin(), frame.end(), record.begin() + kRecordHeaderBytes);
  seal_record(record.data(), frame.size());
  return record;
}

std::array<std::uint8_t, kCsipRecordBytes> encode_csip_record(const CsipBody& body) {
  std::array<std::uint8_t, kCsipRecordBytes> record{};
  const auto header = injector_header(0);
  std::copy(header.begin(), header.end(), record.begin() + kRecordHeaderBytes);
  std::uint8_t* p = record.data() + kRecordHeaderBytes + kDataHeaderBytes;
  std::copy_n("CSIP", 4, p);
  p[4] = kCsipVersion;
  store_le(p + 6, body.session);
  store_le(p + 8, body.counter);
  store_le(p + 16, body.transmit_ns);
  seal_record(record.data(), kDataHeaderBytes + kCsipBodyBytes);
  return record;
}

}  // namespace csipose
