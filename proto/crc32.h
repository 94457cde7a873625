// proto/crc32.h - CRC-32 of IEEE 802.3 (reflected, polynomial 0x04C11DB7), the one of 802.11 frames, zlib and
// MCAP.
#pragma once

#include <cstdint>

#include "proto/bytes.h"

namespace csipose {

/// CRC of `bytes`; to go on from an earlier part, pass that part's CRC. crc32("123456789") = 0xCBF43926.
///   cost  about a byte per clock cycle
std::uint32_t crc32(ByteView bytes, std::uint32_t previous = 0);

}  // namespace csipose
