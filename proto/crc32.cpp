#include "proto/crc32.h"

#include <array>

namespace csipose {
namespace {

constexpr std::uint32_t kPolynomial = 0xEDB88320;  // 0x04C11DB7 with its bits reversed
constexpr std::size_t kSlices = 8;                 // bytes per step
using Tables = std::array<std::array<std::uint32_t, 256>, kSlices>;

/// tables[s][b]: what byte b does to the CRC when s bytes follow it in the same step.
constexpr Tables make_tables() {
  Tables tables{};
  for (std::uint32_t byte = 0; byte < 256; ++byte) {
    std::uint32_t crc = byte;
    for (int bit = 0; bit < 8; ++bit) crc = (crc >> 1) ^ ((crc & 1) != 0 ? kPolynomial : 0);
    tables[0][byte] = crc;
  }
  for (std::size_t s = 1; s < kSlices; ++s)
    for (std::size_t byte = 0; byte < 256; ++byte)
      tables[s][byte] = (tables[s - 1][byte] >> 8) ^ tables[0][tables[s - 1][byte] & 0xFF];
  return tables;
}
constexpr Tables kTables = make_tables();

std::uint32_t eight_bytes(std::uint32_t crc, const std::uint8_t* p) {
  const std::uint64_t word = load_le<std::uint64_t>(p) ^ crc;
  std::uint32_t next = 0;
  for (std::size_t i = 0; i < kSlices; ++i) next ^= kTables[kSlices - 1 - i][(word >> (8 * i)) & 0xFF];
  return next;
}

}  // namespace

std::uint32_t crc32(ByteView bytes, std::uint32_t previous) {
  std::uint32_t crc = ~previous;
  const std::uint8_t* p = bytes.begin();
  for (; bytes.end() - p >= static_cast<std::ptrdiff_t>(kSlices); p += kSlices) crc = eight_bytes(crc, p);
  for (; p != bytes.end(); ++p) crc = (crc >> 8) ^ kTables[0][(crc ^ *p) & 0xFF];
  return ~crc;
}

}  // namespace csipose
