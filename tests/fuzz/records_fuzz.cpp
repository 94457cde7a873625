// Any bytes as a log, whole and in two pieces: framing, resynchronisation and decoding.
#include <cstdlib>

#include "proto/intel5300.h"

namespace {

std::uint64_t decode_all(csipose::RecordStream& stream) {
  std::uint64_t decoded = 0;
  while (const auto raw = stream.next()) {
    csipose::CsiRecord record;
    if (raw->code == csipose::kCsiCode) decoded += !csipose::decode_bfee(raw->body, record);
  }
  return decoded;
}

}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  using csipose::RecordStream;
  const csipose::ByteView bytes(data, size);
  for (const auto policy : {RecordStream::Policy::strict, RecordStream::Policy::resynchronising}) {
    RecordStream whole(bytes, policy);
    const std::uint64_t decoded = decode_all(whole);
    RecordStream growing(bytes.sub(0, size / 2), policy, RecordStream::Input::growing);
    std::uint64_t in_pieces = decode_all(growing);
    growing.refill(bytes, 0);
    in_pieces += decode_all(growing);
    growing.finish();
    in_pieces += decode_all(growing);
    if (in_pieces != decoded) std::abort();  // the cut must not matter
  }
  return 0;
}
