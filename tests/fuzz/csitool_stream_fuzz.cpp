// A stream gives the same packets however it is split: first byte = size of the pieces, rest = the stream.
#include "capture/csitool_stream.h"

#include <algorithm>
#include <cstdlib>
#include <cstring>

using namespace csipose;

static std::vector<std::uint8_t> packets_of(ByteView stream, std::size_t piece, bool& broken) {
  CsitoolStream csitool;
  std::vector<std::uint8_t> all;
  while (!stream.empty() && !csitool.broken()) {
    const CsitoolStream::Room room = csitool.room();
    const std::size_t size = std::min({piece, room.size, stream.size()});
    std::memcpy(room.data, stream.data(), size);
    csitool.filled(size);
    stream = stream.sub(size);
    for (ByteView records = csitool.next(); !records.empty(); records = csitool.next())
      all.insert(all.end(), records.begin(), records.end());
  }
  broken = csitool.broken();
  return all;
}

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  if (size == 0) return 0;
  bool broken = false, split_broken = false;
  const ByteView stream(data + 1, size - 1);
  const auto whole = packets_of(stream, SIZE_MAX, broken);
  const auto split = packets_of(stream, 1u + data[0], split_broken);
  if (whole != split || broken != split_broken) std::abort();
  return 0;
}
