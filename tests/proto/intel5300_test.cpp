#include "proto/intel5300.h"

#include <gtest/gtest.h>

#include <cmath>
#include <nlohmann/json.hpp>
#include <random>
#include <string>

#include "proto/npy.h"
#include "tests/records.h"
#include "tests/shared_data.h"

namespace csipose {
namespace {

/// The oracle: one bit after another, straight from the format's definition, without a thought of speed.
CsiRecord decode_bit_by_bit(ByteView body) {
  CsiRecord record;
  record.nrx = body[8];
  record.ntx = body[9];
  std::size_t bit = 20 * 8;
  const auto next_bits = [&](int count) {
    int value = 0;
    for (int i = 0; i < count; ++i, ++bit) value |= ((body[bit / 8] >> (bit % 8)) & 1) << i;
    return value;
  };
  for (std::size_t k = 0; k < 30; ++k) {
    next_bits(3);
    for (std::size_t j = 0; j < record.nrx; ++j)
      for (std::size_t s = 0; s < record.ntx; ++s)
        for (std::size_t part = 0; part < 2; ++part) {
          const std::size_t antenna = (body[15] >> (2 * j)) & 3;
          const int value = next_bits(8);
          record.csi[((k * 3 + antenna) * 3 + s) * 2 + part] =
              static_cast<std::int8_t>(value < 128 ? value : value - 256);
        }
  }
  return record;
}

ByteView body_of(const std::vector<std::uint8_t>& record) { return ByteView(record).sub(3); }

void expect_equal(const CsiRecord& a, const CsiRecord& b) {
  EXPECT_EQ(a.timestamp_low, b.timestamp_low);
  EXPECT_EQ(a.bfee_count, b.bfee_count);
  EXPECT_EQ(a.nrx, b.nrx);
  EXPECT_EQ(a.ntx, b.ntx);
  EXPECT_EQ(a.rssi, b.rssi);
  EXPECT_EQ(a.noise_dbm, b.noise_dbm);
  EXPECT_EQ(a.agc_db, b.agc_db);
  EXPECT_EQ(a.antenna_sel, b.antenna_sel);
  EXPECT_EQ(a.payload_length, b.payload_length);
  EXPECT_EQ(a.rate, b.rate);
  EXPECT_EQ(a.perm, b.perm);
  EXPECT_EQ(a.perm_valid, b.perm_valid);
  EXPECT_EQ(a.csi, b.csi);
}

TEST(Intel5300, DecodesWhatItEncoded) {
  std::mt19937 random(1);
  for (int nrx = 1; nrx <= 3; ++nrx)
    for (int ntx = 1; ntx <= 3; ++ntx)
      for (int i = 0; i < 50; ++i) {
        const CsiRecord record = testing::random_record(random, nrx, ntx);
        CsiRecord decoded;
        ASSERT_FALSE(decode_bfee(body_of(testing::encoded(record)), decoded));
        expect_equal(decoded, record);
      }
}

TEST(Intel5300, AgreesWithTheBitwiseOracleOnRandomPayloads) {
  std::mt19937 random(2);
  for (int i = 0; i < 2000; ++i) {
    auto bytes = testing::encoded(testing::random_record(random, 1 + i % 3, 1 + i / 3 % 3));
    for (std::size_t at = 23; at < bytes.size(); ++at) bytes[at] = static_cast<std::uint8_t>(random());
    CsiRecord decoded;
    ASSERT_FALSE(decode_bfee(body_of(bytes), decoded));
    ASSERT_EQ(decoded.csi, decode_bit_by_bit(body_of(bytes)).csi);
  }
}

/// The payload ends where the memory ends: a read past it is what the address sanitizer would see.
TEST(Intel5300, EncodesTheRecordedBytesAgain) {
  CSIPOSE_NEEDS_SHARED_DATA();
  for (const char* file : {"sample_0x1_ap", "sample_0x5_64_3000", "log.all_csi.6.7.6"}) {
    const auto bytes = testing::read_bytes(testing::shared_data("csi5300/" + std::string(file) + ".dat"));
    RecordStream stream(bytes, RecordStream::Policy::strict);
    while (const auto raw = stream.next()) {
      if (raw->code != kCsiCode) continue;
      CsiRecord record;
      ASSERT_FALSE(decode_bfee(raw->body, record));
      const auto again = testing::encoded(record);
      const std::vector<std::uint8_t> recorded(raw->framed().begin(), raw->framed().end());
      ASSERT_EQ(again, recorded) << file << " at byte " << raw->offset;
    }
  }
}

TEST(Intel5300, PutsChainsOntoTheirAntennas) {
  std::mt19937 random(3);
  CsiRecord record = testing::random_record(random, 2);
  record.antenna_sel = 0x18;  // chain 0 is antenna A, chain 1 is antenna C
  record.csi.fill(0);
  for (std::size_t k = 0; k < kSubcarriers; ++k) {
    record.csi[CsiRecord::index(k, 0, 0)] = 11;
    record.csi[CsiRecord::index(k, 2, 0)] = -22;
  }
  CsiRecord decoded;
  ASSERT_FALSE(decode_bfee(body_of(testing::encoded(record)), decoded));
  EXPECT_EQ(decoded.at(29, 0, 0), std::complex<float>(11, 0));
  EXPECT_EQ(decoded.at(29, 1, 0), std::complex<float>(0, 0));
  EXPECT_EQ(decoded.at(29, 2, 0), std::complex<float>(-22, 0));
  EXPECT_FALSE(decoded.usable());
}

TEST(Intel5300, KeepsChainOrderWhenThePermutationIsNone) {
  std::mt19937 random(4);
  CsiRecord record = testing::random_record(random);
  const auto bytes = testing::encoded(record);
  for (const int sel : {0x00, 0x15, 0x27, 0x3f}) {
    auto changed = testing::encoded(record);
    changed[3 + 15] = static_cast<std::uint8_t>(sel);
    CsiRecord decoded, chains;
    ASSERT_FALSE(decode_bfee(body_of(changed), decoded));
    EXPECT_FALSE(decoded.perm_valid);
    EXPECT_FALSE(decoded.usable());
    changed[3 + 15] = 0x24;  // chain j is antenna j
    ASSERT_FALSE(decode_bfee(body_of(changed), chains));
    EXPECT_EQ(decoded.csi, chains.csi);
  }
}

TEST(Intel5300, RefusesByTheClosedList) {
  std::mt19937 random(5);
  const auto good = testing::encoded(testing::random_record(random));
  const auto refusal = [&](auto&& damage) {
    auto bytes = good;
    damage(bytes);
    CsiRecord record;
    return decode_bfee(body_of(bytes), record);
  };
  EXPECT_EQ(refusal([](auto& b) { b.resize(3 + 19); }), RecordFault::short_record);
  EXPECT_EQ(refusal([](auto& b) { b.resize(3); }), RecordFault::short_record);
  EXPECT_EQ(refusal([](auto& b) { b.resize(3 + 20); }), RecordFault::payload_short);
  EXPECT_EQ(refusal([](auto& b) { b.pop_back(); }), RecordFault::payload_short);
  EXPECT_EQ(refusal([](auto& b) { b[3 + 8] = 0; }), RecordFault::bad_dims);
  EXPECT_EQ(refusal([](auto& b) { b[3 + 8] = 4; }), RecordFault::bad_dims);
  EXPECT_EQ(refusal([](auto& b) { b[3 + 9] = 255; }), RecordFault::bad_dims);
  EXPECT_EQ(refusal([](auto& b) { b[3 + 16]++; }), RecordFault::bad_len);
  EXPECT_EQ(refusal([](auto& b) { b.push_back(0xAA); }), std::nullopt);
}

TEST(Intel5300, MarksWhatCannotBeScaled) {
  std::mt19937 random(6);
  CsiRecord record = testing::random_record(random), decoded;
  record.csi.fill(0);
  record.rssi.fill(0);
  ASSERT_FALSE(decode_bfee(body_of(testing::encoded(record)), decoded));
  EXPECT_TRUE(decoded.all_zero_csi);
  EXPECT_TRUE(decoded.all_zero_rssi);
  RecordCounts counts;
  count_decoded(counts, std::nullopt, decoded);
  EXPECT_EQ(counts[RecordFault::all_zero_csi], 1u);
  EXPECT_EQ(counts[RecordFault::all_zero_rssi], 1u);
  EXPECT_EQ(counts[RecordFault::perm_invalid], 0u);
}

TEST(Intel5300, ReadsTheRate) {
  const RateFields one = rate_fields(0x101), three = rate_fields(0x2910 | 7);
  EXPECT_TRUE(one.ht && !one.is_40mhz && !one.short_guard && !one.cck && !one.greenfield);
  EXPECT_EQ(one.mcs, 1);
  EXPECT_EQ(one.streams, 1);
  EXPECT_TRUE(three.is_40mhz && three.short_guard);
  EXPECT_EQ(three.mcs, 23);
  EXPECT_EQ(three.streams, 3);
}

TEST(Intel5300, NumbersItsSubcarriers) {
  const auto &narrow = subcarrier_indices(false), &wide = subcarrier_indices(true);
  for (std::size_t k = 1; k < kSubcarriers; ++k) {
    EXPECT_EQ(narrow[k] - narrow[k - 1], narrow[k] == -1 || narrow[k] == 28 ? 1 : 2);
    EXPECT_EQ(wide[k] - wide[k - 1], 4);
  }
  EXPECT_EQ(narrow.front(), -28);
  EXPECT_EQ(narrow.back(), 28);
  EXPECT_EQ(wide.front(), -58);
}

class Golden : public ::testing::TestWithParam<const char*> {};
INSTANTIATE_TEST_SUITE_P(Recordings, Golden,
                         ::testing::Values("sample_0x1_ap", "sample_0x5_64_3000", "log.all_csi.6.7.6"),
                         testing::file_word);

TEST_P(Golden, Fields) {
  CSIPOSE_NEEDS_SHARED_DATA();
  const std::string file = GetParam();
  const auto expected =
      read_npy<std::int64_t>(testing::shared_data("csi5300/expected/" + file + "/fields.npy"));
  const auto bytes = testing::read_bytes(testing::shared_data("csi5300/" + file + ".dat"));
  RecordStream stream(bytes, RecordStream::Policy::strict);
  std::size_t n = 0;
  while (const auto raw = stream.next()) {
    if (raw->code != kCsiCode) continue;
    CsiRecord r;
    ASSERT_FALSE(decode_bfee(raw->body, r));
    const std::array<std::int64_t, 18> row = {static_cast<std::int64_t>(raw->offset),
                                              static_cast<std::int64_t>(raw->body.size() + 1),
                                              r.timestamp_low,
                                              r.bfee_count,
                                              r.nrx,
                                              r.ntx,
                                              r.rssi[0],
                                              r.rssi[1],
                                              r.rssi[2],
                                              r.noise_dbm,
                                              r.agc_db,
                                              r.antenna_sel,
                                              r.payload_length,
                                              r.rate,
                                              r.perm[0],
                                              r.perm[1],
                                              r.perm[2],
                                              r.perm_valid};
    ASSERT_LT(n, expected.shape[0]);
    for (std::size_t i = 0; i < row.size(); ++i)
      ASSERT_EQ(row[i], expected.data[n * 18 + i]) << n << ' ' << i;
    ++n;
  }
  EXPECT_EQ(n, expected.shape[0]);
}

TEST_P(Golden, RawCsi) {
  CSIPOSE_NEEDS_SHARED_DATA();
  const std::string file = GetParam();
  const auto expected =
      read_npy<std::int8_t>(testing::shared_data("csi5300/expected/" + file + "/csi_raw.npy"));
  const auto records = testing::read_csi(testing::shared_data("csi5300/" + file + ".dat"));
  ASSERT_EQ(records.size(), expected.shape[0]);
  const std::size_t streams = expected.shape[3];
  std::size_t at = 0;
  for (const CsiRecord& record : records)
    for (std::size_t k = 0; k < kSubcarriers; ++k)
      for (std::size_t antenna = 0; antenna < kAntennas; ++antenna)
        for (std::size_t i = 0; i < 2 * streams; ++i)
          ASSERT_EQ(record.csi[CsiRecord::index(k, antenna, 0) + i], expected.data[at++]);
}

/// facts.json: histograms and sums over each recording, made by another program.
TEST_P(Golden, Facts) {
  CSIPOSE_NEEDS_SHARED_DATA();
  const std::string file = GetParam();
  const auto all = nlohmann::json::parse(testing::read_bytes(testing::shared_data("csi5300/facts.json")));
  const auto records = testing::read_csi(testing::shared_data("csi5300/" + file + ".dat"));
  const auto facts = *std::find_if(all["files"].begin(), all["files"].end(),
                                   [&](const auto& f) { return f["file"] == file + ".dat"; });
  std::int64_t re = 0, im = 0, abs_re = 0, abs_im = 0, zero_entries = 0;
  nlohmann::json sizes = nlohmann::json::object();
  for (const CsiRecord& r : records) {
    const std::string size = std::to_string(r.nrx) + "x" + std::to_string(r.ntx);
    sizes[size] = sizes.value(size, 0) + 1;
    for (std::size_t k = 0; k < kSubcarriers; ++k)
      for (std::size_t antenna = 0; antenna < kAntennas; ++antenna)
        for (std::size_t s = 0; s < r.ntx; ++s) {
          const std::size_t i = CsiRecord::index(k, antenna, s);
          re += r.csi[i], im += r.csi[i + 1];
          abs_re += std::abs(r.csi[i]), abs_im += std::abs(r.csi[i + 1]);
          zero_entries += r.csi[i] == 0 && r.csi[i + 1] == 0;
        }
  }
  EXPECT_EQ(records.size(), facts["stored_records"]);
  EXPECT_EQ(sizes, facts["nrx_ntx"]);
  EXPECT_EQ(re, facts["csi_int_sums"]["re"]);
  EXPECT_EQ(im, facts["csi_int_sums"]["im"]);
  EXPECT_EQ(abs_re, facts["csi_int_sums"]["abs_re"]);
  EXPECT_EQ(abs_im, facts["csi_int_sums"]["abs_im"]);
  EXPECT_EQ(zero_entries, facts["zero_csi_entries"]);
}

}  // namespace
}  // namespace csipose
