#include "capture/frame_pairer.h"

#include <cassert>

#include "proto/record_stream.h"

namespace csipose {

ByteView FramePairer::add(ByteView record) {
  assert(record.size() >= kRecordHeaderBytes);
  const std::uint8_t code = record[2];
  if (code == kFrameCode) {
    const ByteView alone = flush();
    waiting_.insert(waiting_.end(), record.begin(), record.end());
    return alone;
  }
  if (code != kCsiCode) return {};
  waiting_.insert(waiting_.end(), record.begin(), record.end());
  return flush();
}

ByteView FramePairer::flush() {
  waiting_.swap(given_);
  waiting_.clear();
  return given_;
}

}  // namespace csipose
