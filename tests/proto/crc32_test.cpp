#include "proto/crc32.h"

#include <gtest/gtest.h>

#include <random>
#include <string_view>
#include <vector>

namespace csipose {
namespace {

/// Bit by bit, as the standard words it.
std::uint32_t slow_crc32(ByteView bytes) {
  std::uint32_t crc = 0xFFFFFFFF;
  for (const std::uint8_t byte : bytes)
    for (int bit = 0; bit < 8; ++bit) {
      const bool differs = ((crc ^ (byte >> bit)) & 1) != 0;
      crc = (crc >> 1) ^ (differs ? 0xEDB88320u : 0);
    }
  return ~crc;
}

TEST(Crc32, GivesTheStandardsCheckValue) { EXPECT_EQ(crc32(std::string_view("123456789")), 0xCBF43926u); }

TEST(Crc32, OfNothingIsZero) { EXPECT_EQ(crc32(ByteView()), 0u); }

TEST(Crc32, AgreesWithTheBitwiseDefinitionAtEveryLength) {
  std::mt19937 random(1);
  std::vector<std::uint8_t> bytes;
  for (int length = 0; length < 100; ++length) {
    EXPECT_EQ(crc32(bytes), slow_crc32(bytes)) << length << " bytes";
    bytes.push_back(static_cast<std::uint8_t>(random()));
  }
}

TEST(Crc32, GoesOnWhereAnEarlierPartEnded) {
  const std::string_view text = "a frame check sequence in two parts";
  for (std::size_t cut = 0; cut <= text.size(); ++cut)
    EXPECT_EQ(crc32(text.substr(cut), crc32(text.substr(0, cut))), crc32(text));
}

}  // namespace
}  // namespace csipose
