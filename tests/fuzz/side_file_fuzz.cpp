// Times of a .dat file: side file and NIC clock. Whatever they hold, the line never runs back.
#include "capture/dat_file.h"

#include <algorithm>

using namespace csipose;

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  const ByteView input(data, size);
  if (parse_side_file(input, 1000).size() > std::min<std::size_t>(1000, size / 8)) __builtin_trap();
  std::vector<std::uint32_t> timestamps;
  for (std::size_t at = 0; at + 4 <= size; at += 4) timestamps.push_back(load_le<std::uint32_t>(data + at));
  const NicLine line = unwrap_nic_clock(timestamps);
  if (line.time_ns.size() != timestamps.size()) __builtin_trap();
  for (std::size_t i = 1; i < line.time_ns.size(); ++i)
    if (line.time_ns[i] < line.time_ns[i - 1]) __builtin_trap();
  return 0;
}
