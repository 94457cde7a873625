#include "capture/scale.h"

#include <gtest/gtest.h>

#include <cmath>
#include <string>

#include "proto/npy.h"
#include "tests/records.h"
#include "tests/shared_data.h"

namespace csipose {
namespace {

/// Room for three streams, whatever a record has.
using Matrix = std::array<std::complex<float>, kCsiRows * kMaxStreams>;

/// A record whose every entry is `value`, one stream on three antennas.
CsiRecord uniform_record(std::int8_t value) {
  std::mt19937 random(1);
  CsiRecord record = testing::random_record(random);
  record.csi.fill(0);
  for (std::size_t k = 0; k < kSubcarriers; ++k)
    for (std::size_t antenna = 0; antenna < kAntennas; ++antenna)
      record.csi[CsiRecord::index(k, antenna, 0)] = value;
  record.rssi = {40, 0, 0};
  record.agc_db = 20;
  record.noise_dbm = -80;
  return record;
}

TEST(Scale, IsTheClosedFormOfAUniformChannel) {
  const CsiRecord record = uniform_record(10);
  EXPECT_NEAR(*total_rss_dbm(record), 40 - 44 - 20, 1e-12);
  // P = 90 * 100 / 30; scale = 10^-2.4 / P; noise 1e-8 and 3 entries' quantisation.
  const double scale = std::pow(10, -2.4) / 300;
  EXPECT_NEAR(*scale_factor(record) / std::sqrt(scale / (1e-8 + 3 * scale)), 1, 1e-14);
}

TEST(Scale, TakesMinus92ForUnknownNoise) {
  CsiRecord unknown = uniform_record(10), assumed = uniform_record(10);
  unknown.noise_dbm = -127;
  assumed.noise_dbm = -92;
  EXPECT_EQ(scale_factor(unknown), scale_factor(assumed));
}

TEST(Scale, IsUndefinedWithoutCsiOrWithoutRssi) {
  CsiRecord no_csi = uniform_record(0), no_rssi = uniform_record(10);
  no_rssi.rssi.fill(0);
  Matrix out;
  out.fill(7);
  EXPECT_FALSE(scale_factor(no_csi));
  EXPECT_FALSE(scale_factor(no_rssi));
  EXPECT_FALSE(total_rss_dbm(no_rssi));
  EXPECT_FALSE(scale_csi(no_csi, out));
  EXPECT_FALSE(scale_csi_without_mapping(no_rssi, out));
  EXPECT_EQ(out[0], 7.0f);
}

TEST(Scale, LeavesOutStreamsThatAreNotAskedFor) {
  std::mt19937 random(5);
  const CsiRecord record = testing::random_record(random, 3, 2);
  Matrix three;
  std::array<std::complex<float>, kCsiRows * 2> two;
  for (const auto scale : {scale_csi, scale_csi_without_mapping}) {
    ASSERT_TRUE(scale(record, three) && scale(record, two));
    for (std::size_t row = 0; row < kCsiRows; ++row) {
      EXPECT_EQ(two[2 * row], three[3 * row]);
      EXPECT_EQ(two[2 * row + 1], three[3 * row + 1]);
      EXPECT_EQ(three[3 * row + 2], 0.0f);
    }
  }
}

TEST(Scale, HoldsAtTheEndsOfEveryField) {
  for (const int rssi : {1, 255})
    for (const int agc : {0, 255})
      for (const int noise : {-128, 127})
        for (const int value : {-128, 1, 127}) {
          CsiRecord record = uniform_record(static_cast<std::int8_t>(value));
          record.rssi.fill(static_cast<std::uint8_t>(rssi));
          record.agc_db = static_cast<std::uint8_t>(agc);
          record.noise_dbm = static_cast<std::int8_t>(noise);
          const auto factor = scale_factor(record);
          ASSERT_TRUE(factor);
          EXPECT_TRUE(std::isfinite(*factor) && *factor > 0);
        }
}

/// The mapping is unitary: taking it out keeps each antenna's power.
TEST(Scale, KeepsPowerWhenItRemovesTheMapping) {
  std::mt19937 random(2);
  for (int ntx = 1; ntx <= 3; ++ntx)
    for (const int width : {0, 0x800}) {
      CsiRecord record = testing::random_record(random, 3, ntx);
      record.rate = static_cast<std::uint16_t>(record.rate | width);
      Matrix mapped, unmapped;
      ASSERT_TRUE(scale_csi(record, mapped) && scale_csi_without_mapping(record, unmapped));
      for (std::size_t row = 0; row < kSubcarriers * kAntennas; ++row) {
        double before = 0, after = 0;
        for (std::size_t s = 0; s < kMaxStreams; ++s) {
          before += std::norm(mapped[row * kMaxStreams + s]);
          after += std::norm(unmapped[row * kMaxStreams + s]);
        }
        EXPECT_NEAR(after / before, 1, 1e-6);
      }
    }
}

/// Forwards: a known channel sent through Q must come back. 40 MHz has no recording, so Q stands here as the
/// standard text.
TEST(Scale, UndoesTheMappingOfFortyMegahertz) {
  std::mt19937 random(3);
  CsiRecord record = testing::random_record(random, 3, 2);
  record.rate = 0x908;
  record.csi.fill(0);
  // True channel (60, 0) for every antenna: h * Q2 = 60 / sqrt2 * (1, j); in counts (42, 42 j).
  for (std::size_t k = 0; k < kSubcarriers; ++k)
    for (std::size_t antenna = 0; antenna < kAntennas; ++antenna) {
      record.csi[CsiRecord::index(k, antenna, 0)] = 42;
      record.csi[CsiRecord::index(k, antenna, 1) + 1] = 42;
    }
  Matrix h;
  ASSERT_TRUE(scale_csi_without_mapping(record, h));
  const double expected = 42 * std::sqrt(2) * *scale_factor(record);
  EXPECT_NEAR(h[0].real() / expected, 1, 1e-6);
  EXPECT_NEAR(h[0].imag() / expected, 0, 1e-6);
  EXPECT_NEAR(std::abs(h[1]) / expected, 0, 1e-6);
}

class ScaleGolden : public ::testing::TestWithParam<const char*> {
 protected:
  std::string base() const { return "csi5300/expected/" + std::string(GetParam()) + "/"; }
  std::vector<CsiRecord> records() const {
    return testing::read_csi(testing::shared_data("csi5300/" + std::string(GetParam()) + ".dat"));
  }
};
INSTANTIATE_TEST_SUITE_P(Recordings, ScaleGolden,
                         ::testing::Values("sample_0x1_ap", "sample_0x5_64_3000", "log.all_csi.6.7.6"),
                         testing::file_word);

/// Largest deviation of any record, relative to the record's largest magnitude.
template <class Scale>
double worst_deviation(const std::vector<CsiRecord>& records, const NpyArray<std::complex<float>>& golden,
                       Scale scale) {
  const std::size_t streams = golden.shape[3], entries = kSubcarriers * kAntennas;
  EXPECT_EQ(records.size(), golden.shape[0]);
  double worst = 0;
  for (std::size_t n = 0; n < records.size(); ++n) {
    Matrix h;
    EXPECT_TRUE(scale(records[n], h));
    const std::complex<float>* expected = golden.data.data() + n * entries * streams;
    double difference = 0, largest = 0;
    for (std::size_t i = 0; i < entries; ++i)
      for (std::size_t s = 0; s < streams; ++s) {
        difference =
            std::max<double>(difference, std::abs(h[i * kMaxStreams + s] - expected[i * streams + s]));
        largest = std::max<double>(largest, std::abs(expected[i * streams + s]));
      }
    worst = std::max(worst, difference / largest);
  }
  return worst;
}

TEST_P(ScaleGolden, ScaledCsi) {
  CSIPOSE_NEEDS_SHARED_DATA();
  const auto golden = read_npy<std::complex<float>>(testing::shared_data(base() + "csi_scaled.npy"));
  EXPECT_LT(worst_deviation(records(), golden, scale_csi), 1e-7);  // asked for: 1e-6
}

/// With one stream there is no mapping, and the scaled CSI must come out as it is.
TEST_P(ScaleGolden, ScaledCsiWithoutMapping) {
  CSIPOSE_NEEDS_SHARED_DATA();
  const bool one_stream = std::string(GetParam()) == "sample_0x5_64_3000";
  const char* array = one_stream ? "csi_scaled.npy" : "csi_scaled_sm.npy";
  const auto golden = read_npy<std::complex<float>>(testing::shared_data(base() + array));
  EXPECT_LT(worst_deviation(records(), golden, scale_csi_without_mapping), 1e-7);
}

TEST_P(ScaleGolden, TotalRss) {
  CSIPOSE_NEEDS_SHARED_DATA();
  const auto golden = read_npy<double>(testing::shared_data(base() + "total_rss_dbm.npy"));
  const auto all = records();
  for (std::size_t n = 0; n < all.size(); ++n) ASSERT_NEAR(*total_rss_dbm(all[n]), golden.data[n], 1e-9);
}

/// per_record_sums.npy: sums of counts, and sums in double of |H| and |H|^2, which hold the factor to 1e-12.
TEST_P(ScaleGolden, SumsInDouble) {
  CSIPOSE_NEEDS_SHARED_DATA();
  const auto golden = read_npy<double>(testing::shared_data(base() + "per_record_sums.npy"));
  const auto all = records();
  for (std::size_t n = 0; n < all.size(); ++n) {
    double re = 0, im = 0, magnitude = 0, power = 0;
    for (std::size_t i = 0; i < all[n].csi.size(); i += 2) {
      const std::complex<double> count(all[n].csi[i], all[n].csi[i + 1]), h = count * *scale_factor(all[n]);
      re += count.real(), im += count.imag(), magnitude += std::abs(h), power += std::norm(h);
    }
    const double* expected = golden.data.data() + 4 * n;
    EXPECT_EQ(re, expected[0]);
    EXPECT_EQ(im, expected[1]);
    EXPECT_NEAR(magnitude / expected[2], 1, 1e-12);
    EXPECT_NEAR(power / expected[3], 1, 1e-12);
  }
}

}  // namespace
}  // namespace csipose
