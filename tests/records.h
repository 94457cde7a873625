// tests/records.h - CSI records for tests: read from a log, or made up from a seed.
#pragma once

#include <gtest/gtest.h>

#include <algorithm>
#include <filesystem>
#include <fstream>
#include <iterator>
#include <random>
#include <string>
#include <vector>

#include "proto/intel5300.h"
#include "proto/record_stream.h"

namespace csipose::testing {

inline std::vector<std::uint8_t> read_bytes(const std::filesystem::path& path) {
  std::ifstream file(path, std::ios::binary);
  EXPECT_TRUE(file) << "cannot open " << path;
  return {std::istreambuf_iterator<char>(file), std::istreambuf_iterator<char>()};
}

/// All CSI records of a log that decode.
inline std::vector<CsiRecord> read_csi(const std::filesystem::path& path) {
  const std::vector<std::uint8_t> bytes = read_bytes(path);
  std::vector<CsiRecord> records;
  RecordStream stream(bytes, RecordStream::Policy::resynchronising);
  while (const auto raw = stream.next()) {
    CsiRecord record;
    if (raw->code == kCsiCode && !decode_bfee(raw->body, record)) records.push_back(record);
  }
  return records;
}

/// A record with every field drawn at random, of the given size; its permutation is a valid one.
inline CsiRecord random_record(std::mt19937& random, int nrx = 3, int ntx = 1) {
  static constexpr std::array<std::uint8_t, 6> kOrders = {0x06, 0x09, 0x12, 0x18, 0x21, 0x24};
  const auto byte = [&random](unsigned below = 256) { return static_cast<std::uint8_t>(random() % below); };
  CsiRecord record;
  record.timestamp_low = static_cast<std::uint32_t>(random());
  record.bfee_count = static_cast<std::uint16_t>(random());
  record.nrx = static_cast<std::uint8_t>(nrx);
  record.ntx = static_cast<std::uint8_t>(ntx);
  record.antenna_sel = kOrders[random() % kOrders.size()];
  record.perm = permutation(record.antenna_sel);
  record.perm_valid = true;
  for (int j = 0; j < nrx; ++j) record.rssi[record.perm[j]] = static_cast<std::uint8_t>(3 + random() % 40);
  record.noise_dbm = static_cast<std::int8_t>(-127 + static_cast<int>(random() % 60));
  record.agc_db = static_cast<std::uint8_t>(19 + random() % 44);
  record.rate = static_cast<std::uint16_t>(0x100 | ((ntx - 1) << 3) | byte(8));
  record.payload_length = static_cast<std::uint16_t>(payload_bytes(nrx, ntx));
  for (std::size_t k = 0; k < kSubcarriers; ++k)
    for (int j = 0; j < nrx; ++j)
      for (int i = 0; i < 2 * ntx; ++i)
        record.csi[CsiRecord::index(k, record.perm[j], 0) + i] = static_cast<std::int8_t>(byte());
  return record;
}

inline std::vector<std::uint8_t> encoded(const CsiRecord& record) {
  std::vector<std::uint8_t> bytes;
  append_bfee_record(record, bytes);
  return bytes;
}

/// Name of a test that has a recording's name as its parameter: word characters only.
inline std::string file_word(const ::testing::TestParamInfo<const char*>& test) {
  std::string word = test.param;
  std::replace(word.begin(), word.end(), '.', '_');
  return word;
}

}  // namespace csipose::testing
