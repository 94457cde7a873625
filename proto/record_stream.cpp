#include "proto/record_stream.h"

#include <algorithm>
#include <cassert>

namespace csipose {
namespace {

constexpr std::size_t kLengthBytes = 2;
constexpr std::size_t kCsiHeaderBytes = 20;
/// What must be seen of a CSI record to judge it.
constexpr std::size_t kVisibleBytes = kRecordHeaderBytes + kCsiHeaderBytes;
constexpr std::size_t kSmallestCsiLength =
    33;  // below it no 0xBB header is followed by even an empty payload
constexpr std::size_t kSmallestCsiRecord = 95;  // one chain, one stream

std::size_t record_size(ByteView data, std::size_t at) { return kLengthBytes + load_be16(data.data() + at); }

std::size_t csi_payload_bytes(const std::uint8_t* record) {
  return load_le<std::uint16_t>(record + kRecordHeaderBytes + 16);
}

/// Whether the first kVisibleBytes at `record` could begin a CSI record, and agree on its size.
bool is_plausible_csi(const std::uint8_t* record) {
  const std::size_t length = load_be16(record), payload = csi_payload_bytes(record);
  const unsigned nrx = record[kRecordHeaderBytes + 8], ntx = record[kRecordHeaderBytes + 9];
  if (record[kLengthBytes] != kCsiCode || length < kSmallestCsiLength) return false;
  if (nrx < 1 || nrx > 3 || ntx < 1 || ntx > 3) return false;
  return payload == 60 * nrx * ntx + 12 && length >= 1 + kCsiHeaderBytes + payload;
}

}  // namespace

const char* name(RecordFault fault) {
  static constexpr std::array<const char*, kRecordFaults> kNames = {
      "leftover", "zero_length",   "truncated", "lost_framing", "short_record", "bad_dims",
      "bad_len",  "payload_short", "resync",    "perm_invalid", "all_zero_csi", "all_zero_rssi"};
  return kNames[static_cast<std::size_t>(fault)];
}

RecordCounts& RecordCounts::operator+=(const RecordCounts& other) {
  for (std::size_t i = 0; i < faults.size(); ++i) faults[i] += other.faults[i];
  for (std::size_t i = 0; i < codes.size(); ++i) codes[i] += other.codes[i];
  return *this;
}

bool is_known_code(std::uint8_t code) {
  switch (code) {
    case kCsiCode:
    case kFrameCode:
    case 0xC0:  // PHY result
    case 0xC3:  // RX, older drivers
    case 0xD0:  // noise
    case 0x1C:  // transmit response
    case 0xC5:  // block-ack
    case 0xD1:  // status
    case 0xD2:  // parallel packet
      return true;
    default:
      return false;
  }
}

std::optional<RawRecord> RecordStream::next() {
  fault_.reset();
  if (broken_) return std::nullopt;
  if (searching_) return search();
  if (position_ == data_.size()) return std::nullopt;
  const std::optional<RecordFault> wrong = header_fault();
  if (!wrong) return take();
  if (must_wait()) return std::nullopt;

  count(*wrong);
  fault_ = FramingFault{*wrong, offset()};
  broken_ = policy_ == Policy::strict;
  if (broken_) return std::nullopt;
  searching_ = true;
  position_ = static_cast<std::size_t>(search_start() - base_);
  return search();
}

std::optional<RecordFault> RecordStream::header_fault() const {
  const std::size_t left = data_.size() - position_;
  if (left < kRecordHeaderBytes) return RecordFault::leftover;
  const std::size_t size = record_size(data_, position_);
  if (size == kLengthBytes) return RecordFault::zero_length;
  if (size > left) return RecordFault::truncated;
  const bool believed =
      is_known_code(data_[position_ + kLengthBytes]) || (!in_doubt() && leads_on(position_ + size));
  if (!believed) return RecordFault::lost_framing;
  return std::nullopt;
}

/// Whether `at` is the end, or a header of known code: what must follow a record of unknown code.
bool RecordStream::leads_on(std::size_t at) const {
  if (at == data_.size()) return input_ == Input::whole;
  if (data_.size() - at < kRecordHeaderBytes) return false;
  return load_be16(data_.data() + at) != 0 && is_known_code(data_[at + kLengthBytes]);
}

/// Of a growing input: whether the fault seen may heal when more has come.
bool RecordStream::must_wait() const {
  if (input_ == Input::whole) return false;
  const std::size_t left = data_.size() - position_;
  if (left < kRecordHeaderBytes) return true;
  const std::size_t size = record_size(data_, position_);
  if (size == kLengthBytes) return false;
  return left < size + (is_known_code(data_[position_ + kLengthBytes]) ? 0 : kRecordHeaderBytes);
}

RecordStream::Plausible RecordStream::plausible_csi_at(std::size_t at) const {
  const Plausible cut_off = input_ == Input::growing ? Plausible::not_yet : Plausible::no;
  const std::size_t left = data_.size() - at;
  if (left < kVisibleBytes) return cut_off;
  if (!is_plausible_csi(data_.data() + at)) return Plausible::no;
  return left < record_size(data_, at) ? cut_off : Plausible::yes;
}

std::optional<RawRecord> RecordStream::search() {
  for (; position_ < data_.size(); ++position_) {
    const Plausible plausible = plausible_csi_at(position_);
    if (plausible == Plausible::not_yet) return std::nullopt;
    if (plausible == Plausible::no) continue;
    searching_ = false;
    count(RecordFault::resync);
    return take();
  }
  return std::nullopt;
}

/// Behind the byte where framing failed; or further back, where the record that led there may have swallowed
/// others.
std::uint64_t RecordStream::search_start() const {
  if (!doubt_) return offset() + 1;
  return std::max(*doubt_, base_);
}

RawRecord RecordStream::take() {
  const std::size_t size = record_size(data_, position_);
  RawRecord record;
  record.offset = offset();
  record.code = data_[position_ + kLengthBytes];
  record.body = data_.sub(position_ + kRecordHeaderBytes, size - kRecordHeaderBytes);
  ++counts_.codes[record.code];
  position_ += size;
  note_doubt(record);
  return record;
}

/// A CSI record says its size twice, so one that agrees with itself confirms the framing up to its payload's
/// end. Any bytes beyond what a record is known to hold, enough for a whole CSI record, put the framing in
/// doubt.
void RecordStream::note_doubt(const RawRecord& record) {
  const ByteView framed = record.framed();
  const bool is_csi = framed.size() >= kVisibleBytes && is_plausible_csi(framed.data());
  const std::size_t known =
      kRecordHeaderBytes + (is_csi ? kCsiHeaderBytes + csi_payload_bytes(framed.data()) : 0);
  if (is_csi) doubt_.reset();
  if (!doubt_ && framed.size() >= known + kSmallestCsiRecord) doubt_ = record.offset + known;
}

void RecordStream::refill(ByteView data, std::uint64_t data_offset) {
  assert(data_offset <= offset() && offset() - data_offset <= data.size());
  position_ = static_cast<std::size_t>(offset() - data_offset);
  base_ = data_offset;
  data_ = data;
}

}  // namespace csipose
