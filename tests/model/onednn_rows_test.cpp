// Row operations of every instruction set this processor has, against plain loops.
#include "model/onednn_rows.h"

#include <gtest/gtest.h>

#include <cmath>
#include <limits>
#include <random>
#include <vector>

namespace csipose {
namespace {

std::vector<CpuFeatures> instruction_sets() {
  const CpuFeatures here = cpu_features();
  std::vector<CpuFeatures> sets(1);
  if (here.avx2) sets.emplace_back().avx2 = true;
  if (here.avx512) sets.emplace_back().avx512 = true;
  return sets;
}

std::vector<float> numbers(std::size_t count, float spread, unsigned seed) {
  std::mt19937 random(seed);
  std::normal_distribution<float> normal(0, spread);
  std::vector<float> values(count);
  for (float& value : values) value = normal(random);
  return values;
}

constexpr std::size_t kRows = 3;

class Rows : public ::testing::TestWithParam<std::size_t> {  // the width
 protected:
  const std::size_t width = GetParam();
  const std::vector<float> x = numbers(kRows * width, 3, 1), gain = numbers(width, 1, 2),
                           bias = numbers(width, 1, 3), position = numbers(kRows * width, 1, 4);
  std::vector<float> out = std::vector<float>(kRows * width + 1, 99.f);  // the last one must stay
};
INSTANTIATE_TEST_SUITE_P(Widths, Rows, ::testing::Values(1, 3, 14, 16, 20, 42, 64, 180, 513));

TEST_P(Rows, NormMatchesItsDefinition) {
  for (const CpuFeatures& cpu : instruction_sets()) {
    std::vector<float> with_position(kRows * width), copy(kRows * width);
    row_kernels(cpu).norm({x.data(),
                           width,
                           gain.data(),
                           bias.data(),
                           1e-5f,
                           copy.data(),
                           {out.data()},
                           position.data(),
                           {with_position.data()}},
                          0, kRows);
    for (std::size_t r = 0; r < kRows; ++r) {
      double mean = 0, variance = 0;
      for (std::size_t c = 0; c < width; ++c) mean += double{x[r * width + c]} / double(width);
      for (std::size_t c = 0; c < width; ++c)
        variance += std::pow(double{x[r * width + c]} - mean, 2) / double(width);
      for (std::size_t c = 0; c < width; ++c) {
        const std::size_t i = r * width + c;
        const double y =
            (double{x[i]} - mean) / std::sqrt(variance + 1e-5) * double{gain[c]} + double{bias[c]};
        ASSERT_NEAR(out[i], y, 2e-5) << row_kernels(cpu).name << " row " << r << " column " << c;
        ASSERT_EQ(copy[i], out[i]);
        ASSERT_EQ(with_position[i], out[i] + position[i]);
      }
    }
    EXPECT_EQ(out.back(), 99.f);
  }
}

TEST_P(Rows, SoftmaxMatchesItsDefinition) {
  for (const CpuFeatures& cpu : instruction_sets()) {
    row_kernels(cpu).softmax({x.data(), width, 0.7f, {out.data()}}, 0, kRows);
    for (std::size_t r = 0; r < kRows; ++r) {
      double sum = 0;
      for (std::size_t c = 0; c < width; ++c) sum += std::exp(0.7 * double{x[r * width + c]});
      for (std::size_t c = 0; c < width; ++c) {
        const double y = std::exp(0.7 * double{x[r * width + c]}) / sum;
        ASSERT_NEAR(out[r * width + c], y, 2e-6 * y + 1e-9) << row_kernels(cpu).name;
      }
    }
    EXPECT_EQ(out.back(), 99.f);
  }
}

TEST_P(Rows, StoresInEveryFormat) {
  for (const CpuFeatures& cpu : instruction_sets()) {
    std::vector<std::uint16_t> halves(kRows * width + 1, 7);
    std::vector<std::int8_t> bytes(kRows * width + 1, 7);
    row_kernels(cpu).store({x.data(), width, position.data(), {halves.data(), Element::bf16}}, 0, kRows);
    row_kernels(cpu).store({x.data(), width, nullptr, {bytes.data(), Element::s8, 20.f}}, 0, kRows);
    for (std::size_t i = 0; i < x.size(); ++i) {
      ASSERT_EQ(halves[i], to_bf16(x[i] + position[i]));
      ASSERT_EQ(int{bytes[i]}, static_cast<int>(std::nearbyint(std::min(127.f, std::max(-127.f, x[i] * 20)))))
          << x[i];
    }
    EXPECT_EQ(halves.back(), 7);
    EXPECT_EQ(bytes.back(), 7);
  }
}

TEST(RowKernels, DoOnlyTheRowsAskedFor) {
  const std::vector<float> x(4 * 20, 1.f);
  for (const CpuFeatures& cpu : instruction_sets()) {
    std::vector<float> out(4 * 20, 5.f);
    row_kernels(cpu).store({x.data(), 20, nullptr, {out.data()}}, 1, 3);
    for (std::size_t i = 0; i < out.size(); ++i) ASSERT_EQ(out[i], i >= 20 && i < 60 ? 1.f : 5.f);
  }
}

TEST(RowKernels, SoftmaxOfHugeScoresIsFinite) {
  for (const CpuFeatures& cpu : instruction_sets()) {
    std::vector<float> x = {3e38f, -3e38f, 0, 3e38f, -1e4f};
    row_kernels(cpu).softmax({x.data(), x.size(), 1, {x.data()}}, 0, 1);
    EXPECT_EQ(x, (std::vector<float>{0.5f, 0, 0, 0.5f, 0}));
  }
}

TEST(RowKernels, BytesNeverLeaveTheirRange) {
  const float inf = std::numeric_limits<float>::infinity();
  const std::vector<float> x = {1e30f, -1e30f, inf, -inf, 126.5f, 127.5f, -126.5f, std::nanf("")};
  for (const CpuFeatures& cpu : instruction_sets()) {
    std::vector<std::int8_t> out(x.size());
    row_kernels(cpu).store({x.data(), x.size(), nullptr, {out.data(), Element::s8}}, 0, 1);
    EXPECT_EQ(out, (std::vector<std::int8_t>{127, -127, 127, -127, 126, 127, -126, -127}))
        << row_kernels(cpu).name;
  }
}

TEST(Bf16, RoundsToNearestEvenAndKeepsNaN) {
  EXPECT_EQ(from_bf16(to_bf16(1.f)), 1.f);
  EXPECT_EQ(from_bf16(to_bf16(1.f + 1.f / 256)), 1.f);              // a tie: even below
  EXPECT_EQ(from_bf16(to_bf16(1.f + 3.f / 256)), 1.f + 4.f / 256);  // a tie: even above
  EXPECT_EQ(from_bf16(to_bf16(-1.f - 1.1f / 256)), -1.f - 2.f / 256);
  EXPECT_TRUE(std::isnan(from_bf16(to_bf16(std::nanf("")))));
  EXPECT_TRUE(std::isinf(from_bf16(to_bf16(std::numeric_limits<float>::max()))));
}

TEST(Bf16, EveryInstructionSetAgreesWithTheScalarOne) {
  std::vector<float> x = numbers(256, 1e3f, 9);
  x[3] = std::nanf("");
  x[77] = -std::numeric_limits<float>::infinity();
  for (const CpuFeatures& cpu : instruction_sets()) {
    std::vector<std::uint16_t> out(x.size());
    row_kernels(cpu).store({x.data(), x.size(), nullptr, {out.data(), Element::bf16}}, 0, 1);
    for (std::size_t i = 0; i < x.size(); ++i) ASSERT_EQ(out[i], to_bf16(x[i])) << x[i];
  }
}

}  // namespace
}  // namespace csipose
