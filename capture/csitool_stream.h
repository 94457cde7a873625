// capture/csitool_stream.h - csitool's log stream as it comes from a reliable carrier, in pieces split anywhere.
#pragma once

#include <vector>

#include "capture/frame_pairer.h"
#include "proto/record_stream.h"

namespace csipose {

class CsitoolStream {
 public:
  CsitoolStream();

  /// Where the next bytes of the stream are to be put; there is always room. Bytes before it that are not yet consumed
  /// move, so records given before are no longer valid.
  struct Room {
    std::uint8_t* data;
    std::size_t size;
  };
  Room room();
  /// This many bytes have been put there.
  void filled(std::size_t bytes);

  /// Records of the next whole packet (see frame_pairer.h), valid until the next call; empty: nothing whole yet, or
  /// broken.
  ByteView next();
  /// A framing error was met: nothing more will come.
  bool broken() const { return stream_.broken(); }

 private:
  std::vector<std::uint8_t> buffer_;
  std::size_t used_ = 0;
  std::uint64_t start_ = 0;  // place of buffer_[0] in the stream
  RecordStream stream_{{}, RecordStream::Policy::strict, RecordStream::Input::growing};
  FramePairer pairer_;
};

}  // namespace csipose
