// Matrix product and attention on oneDNN against plain loops in double.
#include "model/onednn_ops.h"

#include <gtest/gtest.h>

#include <cmath>
#include <random>
#include <vector>

#include "proto/result.h"

namespace csipose {
namespace {

std::vector<float> numbers(std::size_t count, unsigned seed) {
  std::mt19937 random(seed);
  std::normal_distribution<float> normal(0, 1);
  std::vector<float> values(count);
  for (float& value : values) value = normal(random);
  return values;
}

/// Rows as the operation reads them, and what they then stand for.
struct Stored {
  Buffer bytes;
  std::vector<double> meaning;
};
Stored stored(const OneDnnContext& context, const std::vector<float>& x, Element element, float scale = 1) {
  Stored result;
  result.bytes = Buffer(x.size() * size_of(element));
  context.store({x.data(), x.size(), nullptr, {result.bytes.data(), element, 1 / scale}}, 1);
  for (std::size_t i = 0; i < x.size(); ++i) switch (element) {
      case Element::f32:
        result.meaning.push_back(double{x[i]});
        break;
      case Element::bf16:
        result.meaning.push_back(double{from_bf16(static_cast<std::uint16_t*>(result.bytes.data())[i])});
        break;
      case Element::s8:
        result.meaning.push_back(double{scale} * static_cast<std::int8_t*>(result.bytes.data())[i]);
        break;
    }
  return result;
}
std::vector<double> meaning_of(const Buffer& buffer, std::size_t count, Element element, float scale = 1) {
  std::vector<double> values;
  for (std::size_t i = 0; i < count; ++i) switch (element) {
      case Element::f32:
        values.push_back(double{buffer.floats()[i]});
        break;
      case Element::bf16:
        values.push_back(double{from_bf16(static_cast<std::uint16_t*>(buffer.data())[i])});
        break;
      case Element::s8:
        values.push_back(double{scale} * static_cast<std::int8_t*>(buffer.data())[i]);
        break;
    }
  return values;
}

bool possible(Element element) {
  const CpuFeatures cpu = cpu_features();
  if (element == Element::bf16) return cpu.avx512_bf16;
  return element == Element::f32 || cpu.avx512_vnni;
}

struct Case {
  Element source, destination;
  Epilogue epilogue;
  double tolerance;  ///< relative to the result's spread; what storing the result in its format costs
};

class LinearOf : public ::testing::TestWithParam<Case> {
 protected:
  static constexpr std::size_t kInputs = 60, kOutputs = 42;
  OneDnnContext context{1, {}};
  const std::vector<float> weight = numbers(kInputs * kOutputs, 1), bias = numbers(kOutputs, 2);
};
INSTANTIATE_TEST_SUITE_P(Formats, LinearOf,
                         ::testing::Values(Case{Element::f32, Element::f32, Epilogue::none, 3e-6},
                                           Case{Element::f32, Element::f32, Epilogue::relu, 3e-6},
                                           Case{Element::f32, Element::f32, Epilogue::gelu, 1e-5},
                                           Case{Element::f32, Element::f32, Epilogue::add, 3e-6},
                                           Case{Element::bf16, Element::bf16, Epilogue::none, 0.02},
                                           Case{Element::bf16, Element::bf16, Epilogue::relu, 0.02},
                                           Case{Element::bf16, Element::bf16, Epilogue::gelu, 0.02},
                                           Case{Element::bf16, Element::f32, Epilogue::add, 0.02},
                                           Case{Element::s8, Element::f32, Epilogue::none, 3e-6},
                                           Case{Element::s8, Element::f32, Epilogue::add, 3e-6},
                                           Case{Element::s8, Element::s8, Epilogue::gelu, 0.02}));

double after(Epilogue epilogue, double x, double before) {
  switch (epilogue) {
    case Epilogue::none:
      break;
    case Epilogue::relu:
      return std::max(x, 0.0);
    case Epilogue::gelu:
      return x / 2 * (1 + std::erf(x / std::sqrt(2.0)));
    case Epilogue::add:
      return x + before;
  }
  return x;
}

/// The weights as the operation has them: int8 in 127 steps of each output's largest.
std::vector<double> weights_in(Element element, const std::vector<float>& weight, std::size_t inputs) {
  std::vector<double> result(weight.begin(), weight.end());
  if (element == Element::f32) return result;
  for (std::size_t o = 0; o < weight.size() / inputs; ++o) {
    float most = 0;
    for (std::size_t i = 0; i < inputs; ++i) most = std::max(most, std::abs(weight[o * inputs + i]));
    for (std::size_t i = o * inputs; i < (o + 1) * inputs; ++i)
      result[i] = element == Element::s8 ? std::nearbyint(weight[i] / (most / 127)) * double{most} / 127
                                         : double{from_bf16(to_bf16(weight[i]))};
  }
  return result;
}

TEST_P(LinearOf, MatchesTheLoop) {
  const auto [source, destination, epilogue, tolerance] = GetParam();
  if (!possible(source)) GTEST_SKIP() << "this processor has no unit for it: " << to_string(context.cpu());
  constexpr float kInputScale = 4.f / 127, kOutputScale = 40.f / 127;
  Linear linear(context, {weight, bias}, {source, destination, epilogue, kInputScale, kOutputScale}, "test");
  constexpr double kSpread = 8;  // sqrt(60)
  const std::vector<double> exact_weight = weights_in(source, weight, kInputs);
  for (const std::size_t rows : {1, 14, 60, 180}) {
    linear.prepare(rows);
    const Stored x = stored(context, numbers(rows * kInputs, 3), source, kInputScale);
    Buffer y(rows * kOutputs * size_of(destination));
    const std::vector<double> before = meaning_of(y, rows * kOutputs, destination, kOutputScale);
    linear.run(x.bytes.data(), y.data(), rows);
    const std::vector<double> got = meaning_of(y, rows * kOutputs, destination, kOutputScale);
    for (std::size_t r = 0; r < rows; ++r)
      for (std::size_t o = 0; o < kOutputs; ++o) {
        double sum = double{bias[o]};
        for (std::size_t i = 0; i < kInputs; ++i)
          sum += x.meaning[r * kInputs + i] * exact_weight[o * kInputs + i];
        ASSERT_NEAR(got[r * kOutputs + o], after(epilogue, sum, before[r * kOutputs + o]),
                    tolerance * kSpread)
            << rows << " rows: " << r << ", " << o;
      }
  }
}

TEST(Linear, AddsOntoTheDestination) {
  OneDnnContext context(1, {});
  const std::vector<float> weight(16 * 16, 0.f), bias(16, 2.f);
  Linear linear(context, {weight, bias}, {Element::f32, Element::f32, Epilogue::add}, "test");
  linear.prepare(2);
  const Buffer x(2 * 16 * 4);
  std::vector<float> y(2 * 16, 5.f);
  linear.run(x.data(), y.data(), 2);
  EXPECT_EQ(y, std::vector<float>(2 * 16, 7.f));
}

TEST(Linear, OneOutputIsFastCodeToo) {
  OneDnnContext context(1, {});
  const std::vector<float> weight = numbers(256, 1), bias = {1.f};
  Linear linear(context, {weight, bias}, {}, "test");
  linear.prepare(100);
  EXPECT_EQ(linear.implementation().find("ref"), std::string::npos);
}

TEST(Linear, ColumnOfZerosInInt8) {
  if (!possible(Element::s8)) GTEST_SKIP() << "no VNNI";
  OneDnnContext context(1, {});
  const std::vector<float> weight(64 * 16, 0.f), bias(16, -3.f);
  Linear linear(context, {weight, bias}, {Element::s8, Element::f32}, "test");
  linear.prepare(4);
  const Buffer x(4 * 64);
  std::vector<float> y(4 * 16);
  linear.run(x.data(), y.data(), 4);
  EXPECT_EQ(y, std::vector<float>(4 * 16, -3.f));
}

void expect_attention(Element element, double tolerance, std::size_t batch, std::size_t queries,
                      std::size_t keys) {
  constexpr std::size_t kWidth = 32, kHeads = 4, kHead = kWidth / kHeads;
  OneDnnContext context(1, {});
  const Stored q = stored(context, numbers(batch * queries * kWidth, 1), element),
               k = stored(context, numbers(batch * keys * kWidth, 2), element),
               v = stored(context, numbers(batch * keys * kWidth, 3), element);
  Attention attention(context, kWidth, kHeads, element, element);
  attention.prepare({batch, queries, keys});
  Buffer y(batch * queries * kWidth * size_of(element));
  attention.run(q.bytes.data(), k.bytes.data(), v.bytes.data(), y.data(), {batch, queries, keys});
  const std::vector<double> got = meaning_of(y, batch * queries * kWidth, element);
  for (std::size_t b = 0; b < batch; ++b)
    for (std::size_t h = 0; h < kHeads; ++h)
      for (std::size_t r = 0; r < queries; ++r) {
        std::vector<double> weights(keys);
        double sum = 0;
        for (std::size_t m = 0; m < keys; ++m) {
          for (std::size_t c = 0; c < kHead; ++c)
            weights[m] += q.meaning[(b * queries + r) * kWidth + h * kHead + c] *
                          k.meaning[(b * keys + m) * kWidth + h * kHead + c];
          sum += weights[m] = std::exp(weights[m] / std::sqrt(double{kHead}));
        }
        for (std::size_t c = 0; c < kHead; ++c) {
          double y_wanted = 0;
          for (std::size_t m = 0; m < keys; ++m)
            y_wanted += weights[m] / sum * v.meaning[(b * keys + m) * kWidth + h * kHead + c];
          ASSERT_NEAR(got[(b * queries + r) * kWidth + h * kHead + c], y_wanted, tolerance);
        }
      }
}

TEST(Attention, MatchesTheLoop) {
  expect_attention(Element::f32, 2e-6, 1, 180, 180);
  expect_attention(Element::f32, 2e-6, 1, 6, 20);
  expect_attention(Element::f32, 2e-6, 8, 14, 14);
}

TEST(Attention, MatchesTheLoopInBf16) {
  if (!possible(Element::bf16)) GTEST_SKIP() << "no unit for bf16";
  expect_attention(Element::bf16, 0.02, 1, 180, 180);
  expect_attention(Element::bf16, 0.02, 1, 112, 60);
  expect_attention(Element::bf16, 0.02, 8, 14, 14);
}

TEST(OneDnnContext, RefusesTheLibrarysReferenceLoop) {
  OneDnnContext context(1, {});
  EXPECT_THROW(context.note_implementation("ref:any", "test"), SetupError);
  EXPECT_NO_THROW(context.note_implementation("brg:avx512_core", "test"));
}

TEST(OneDnnContext, RefusesThreadsThatCannotBe) {
  EXPECT_THROW(OneDnnContext(0, {}), SetupError);
  EXPECT_THROW(OneDnnContext(2, {0}), SetupError);
  EXPECT_THROW(OneDnnContext(1, {1000}), SetupError);
}

}  // namespace
}  // namespace csipose
