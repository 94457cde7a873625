// Any bytes as a received frame: as they are, and with the FCS put right so that what lies behind it is
// reached.
#include <vector>

#include "capture/tx_counter.h"
#include "proto/frame_record.h"

namespace {

void recover(csipose::ByteView frame) {
  static csipose::CounterRecovery counters(csipose::CounterMethod::automatic);
  static csipose::CounterRecovery sequence(csipose::CounterMethod::sequence12);
  if (const auto mpdu = csipose::parse_mpdu(frame)) {
    counters.recover(*mpdu);
    sequence.recover(*mpdu);
  }
}

}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  recover({data, size});
  if (size > 60000) return 0;
  const std::vector<std::uint8_t> record = csipose::encode_frame_record(csipose::ByteView(data, size));
  recover(csipose::ByteView(record).sub(3));
  return 0;
}
