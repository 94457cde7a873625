#include "capture/csitool_stream.h"

#include <cassert>
#include <cstring>

namespace csipose {
namespace {
constexpr std::size_t kBufferBytes =
    2 * 65'537;  // the longest record, and as much again so that reads are not tiny
}

CsitoolStream::CsitoolStream() : buffer_(kBufferBytes) {}

CsitoolStream::Room CsitoolStream::room() {
  const std::size_t consumed = stream_.offset() - start_;
  std::memmove(buffer_.data(), buffer_.data() + consumed, used_ - consumed);
  used_ -= consumed;
  start_ += consumed;
  stream_.refill({buffer_.data(), used_}, start_);
  return {buffer_.data() + used_, buffer_.size() - used_};
}

void CsitoolStream::filled(std::size_t bytes) {
  used_ += bytes;
  assert(used_ <= buffer_.size());
  stream_.refill({buffer_.data(), used_}, start_);
}

ByteView CsitoolStream::next() {
  while (const auto record = stream_.next()) {
    const ByteView records = pairer_.add(record->framed());
    if (!records.empty()) return records;
  }
  return {};
}

}  // namespace csipose
