#include "capture/features.h"

#include <gtest/gtest.h>

#include <cmath>
#include <string>

#include "proto/npy.h"
#include "proto/window.h"
#include "tests/records.h"
#include "tests/shared_data.h"

namespace csipose {
namespace {

TEST(Features, RefusesAStreamThatTheRecordHasNot) {
  std::mt19937 random(1);
  const CsiRecord record = testing::random_record(random, 3, 2);
  Features features;
  EXPECT_TRUE(extract_features(record, {.stream = 1}, features));
  EXPECT_FALSE(extract_features(record, {.stream = 2}, features));
}

TEST(Features, RefusesToScaleWhatHasNoScale) {
  std::mt19937 random(2);
  CsiRecord record = testing::random_record(random);
  record.rssi.fill(0);
  Features features;
  EXPECT_TRUE(extract_features(record, {.amplitude = AmplitudeMethod::raw}, features));
  EXPECT_FALSE(extract_features(record, {.amplitude = AmplitudeMethod::scaled}, features));
}

TEST(Features, AreFiniteAndWrappedForAnyRecord) {
  std::mt19937 random(3);
  for (int i = 0; i < 300; ++i) {
    const CsiRecord record = testing::random_record(random);
    for (const PhaseMethod phase : {PhaseMethod::joint, PhaseMethod::phasefi}) {
      Features features;
      ASSERT_TRUE(extract_features(record, {.phase = phase, .amplitude = AmplitudeMethod::scaled}, features));
      for (const float feature : features) ASSERT_TRUE(std::isfinite(feature));
      for (std::size_t at = kSubcarriers * kAntennas; at < features.size(); ++at)
        ASSERT_LE(std::abs(features[at]), 3.1415928f);
    }
  }
}

/// Three pseudo receivers from 60 records in a row: receiver r is records first + 20 r .. + 19.
struct TensorCase {
  const char* file;
  std::size_t first;
  const char* amplitude;
};
std::string test_word(const ::testing::TestParamInfo<TensorCase>& test) {
  const auto& [file, first, amplitude] = test.param;
  return std::string(file) + "_" + std::to_string(first) + "_" + amplitude;
}
class GoldenTensor : public ::testing::TestWithParam<TensorCase> {};
INSTANTIATE_TEST_SUITE_P(All, GoldenTensor,
                         ::testing::Values(TensorCase{"sample_0x5_64_3000", 0, "raw"},
                                           TensorCase{"sample_0x5_64_3000", 0, "scaled"},
                                           TensorCase{"sample_0x5_64_3000", 1200, "raw"},
                                           TensorCase{"sample_0x5_64_3000", 1200, "scaled"},
                                           TensorCase{"sample_0x1_ap", 0, "raw"},
                                           TensorCase{"sample_0x1_ap", 0, "scaled"}),
                         test_word);

TEST_P(GoldenTensor, IsMetUnderItsMasks) {
  CSIPOSE_NEEDS_SHARED_DATA();
  const auto [file, first, amplitude] = GetParam();
  const std::string base =
      "csi5300/phase/tensor_" + std::string(file) + "_b" + std::to_string(first) + "_tx0_";
  const auto golden = read_npy<float>(testing::shared_data(base + amplitude + ".npy"));
  const auto mask = read_npy<std::uint8_t>(testing::shared_data(base + "raw_mask.npy"));
  const auto stable = read_npy<std::uint8_t>(testing::shared_data(base + "raw_stable.npy"));
  ASSERT_EQ(golden.shape, (NpyShape{kChannels, kSamples, kLinks}));
  const auto records = testing::read_csi(testing::shared_data("csi5300/" + std::string(file) + ".dat"));
  const FeatureOptions options{.amplitude = std::string(amplitude) == "raw" ? AmplitudeMethod::raw
                                                                            : AmplitudeMethod::scaled};

  std::size_t phases = 0;
  for (std::size_t rx = 0; rx < kReceivers; ++rx)
    for (std::size_t t = 0; t < kSamples; ++t) {
      Features features;
      ASSERT_TRUE(extract_features(records[first + 20 * rx + t], options, features));
      for (std::size_t c = 0; c < kChannels; ++c)
        for (std::size_t antenna = 0; antenna < kAntennas; ++antenna) {
          const std::size_t at = Window::index(c, t, 3 * rx + antenna);
          const float ours = features[c * kAntennas + antenna], theirs = golden.data[at];
          if (c < kSubcarriers) {
            ASSERT_NEAR(ours, theirs, 1e-5 * std::abs(theirs));
          } else if (mask.data[at - Window::index(kSubcarriers, 0, 0)] != 0 &&
                     stable.data[rx * kSamples + t] != 0) {
            ASSERT_LT(std::abs(wrap_phase(double{ours} - double{theirs})), 1e-5)
                << c << ' ' << t << ' ' << rx;
            ++phases;
          }
        }
    }
  EXPECT_GT(phases, 3000u);
}

}  // namespace
}  // namespace csipose
