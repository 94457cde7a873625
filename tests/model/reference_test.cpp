#include "model/reference.h"

#include <gtest/gtest.h>

#include <cmath>

#include "model/safetensors.h"
#include "proto/npy.h"
#include "tests/shared_data.h"

namespace csipose::reference {
namespace {

constexpr float kTolerance = 1e-4f;  // of the golden networks, float32

TensorMap load_weights(const std::string& relative) {
  TensorMap weights;
  const SafetensorsFile file = SafetensorsFile::read(csipose::testing::shared_data(relative));
  for (const TensorView& view : file.tensors()) weights.add(view.name, {view.shape, to_floats(view)});
  return weights;
}

NpyArray<float> golden(const std::string& relative) {
  return read_npy<float>(csipose::testing::shared_data("model/" + relative));
}

/// Largest difference to the part of a golden array that starts at `first`.
float difference(const Matrix& ours, const NpyArray<float>& theirs, std::size_t first) {
  float largest = ours.data.empty() ? HUGE_VALF : 0;
  for (std::size_t i = 0; i < ours.data.size(); ++i)
    largest = std::max(largest, std::fabs(ours.data[i] - theirs.data.at(first + i)));
  return largest;
}

std::vector<std::size_t> all_tokens() { return NetworkConfig{}.tokens_there(LinkSet().set()); }

TEST(Reference, PositionCodeIsTheGoldenOne) {
  CSIPOSE_NEEDS_SHARED_DATA();
  for (const std::size_t width : {std::size_t{32}, std::size_t{512}}) {
    const auto theirs = golden("posembed/pe_t20_l9_d" + std::to_string(width) + ".npy");
    const Matrix ours = position_code(width);
    ASSERT_EQ(theirs.data.size(), ours.data.size());
    EXPECT_LE(difference(ours, theirs, 0), 1e-6f);
  }
}

TEST(Reference, EncoderIsTheGoldenOne) {
  CSIPOSE_NEEDS_SHARED_DATA();
  const TensorMap weights = load_weights("model/vit_tiny/weights.safetensors");
  const auto x = golden("vit_tiny/x.npy"), embed = golden("vit_tiny/embed.npy"),
             block0 = golden("vit_tiny/block0.npy"), full = golden("vit_tiny/out_full.npy"),
             part = golden("vit_tiny/out_context.npy");
  const auto context =
      read_npy<std::int64_t>(csipose::testing::shared_data("model/vit_tiny/context_idx.npy"));
  const EncoderShape shape = {32, 2, 4};
  for (std::size_t b = 0; b < 2; ++b) {
    const Matrix tokens = tokens_of(std::span(x.data).subspan(b * kChannels * kTokens, kChannels * kTokens));
    const EncoderOutput all = encode(weights, "", shape, tokens, all_tokens());
    EXPECT_LE(difference(all.embed, embed, b * kTokens * 32), kTolerance);
    EXPECT_LE(difference(all.blocks[0], block0, b * kTokens * 32), kTolerance);
    EXPECT_LE(difference(all.tokens, full, b * kTokens * 32), kTolerance);
    const std::vector<std::size_t> visible(context.data.begin() + static_cast<std::ptrdiff_t>(b * 80),
                                           context.data.begin() + static_cast<std::ptrdiff_t>(b * 80 + 80));
    const EncoderOutput gathered = encode(weights, "", shape, tokens, visible);
    ASSERT_EQ(gathered.tokens.rows, 80u);
    EXPECT_LE(difference(gathered.tokens, part, b * 80 * 32), kTolerance);
  }
}

class GoldenDecoder : public ::testing::Test {
 protected:
  static constexpr std::size_t kMemoryRows = 20, kWidth = 32, kQueries = 6;
  DecoderOutput run(std::size_t window) const {
    const auto memory = golden("decoder_tiny/memory.npy");
    Matrix rows(kMemoryRows, kWidth);
    std::copy_n(memory.data.begin() + static_cast<std::ptrdiff_t>(window * rows.data.size()),
                rows.data.size(), rows.data.begin());
    const TensorMap weights = load_weights("model/decoder_tiny/weights.safetensors");
    return decode(weights, {4, 3, 2, false, false}, rows);
  }
};

TEST_F(GoldenDecoder, IsTheGoldenOneStageByStage) {
  CSIPOSE_NEEDS_SHARED_DATA();
  const auto enc_cls = golden("decoder_tiny/enc_cls.npy"), enc_kpt = golden("decoder_tiny/enc_kpt.npy"),
             layer0 = golden("decoder_tiny/layer0_out.npy"), hidden = golden("decoder_tiny/dec_hidden.npy"),
             cls = golden("decoder_tiny/all_cls.npy"), kpt = golden("decoder_tiny/all_kpt.npy"),
             refined = golden("decoder_tiny/refined.npy");
  const auto topk = read_npy<std::int64_t>(csipose::testing::shared_data("model/decoder_tiny/topk_idx.npy"));
  for (std::size_t b = 0; b < 2; ++b) {
    const DecoderOutput out = run(b);
    EXPECT_LE(difference(out.enc_cls, enc_cls, b * kMemoryRows), kTolerance);
    EXPECT_LE(difference(out.enc_kpt, enc_kpt, b * kMemoryRows * 42), kTolerance);
    ASSERT_EQ(out.topk.size(), kQueries);
    for (std::size_t q = 0; q < kQueries; ++q)
      EXPECT_EQ(static_cast<std::int64_t>(out.topk[q]), topk.data[b * kQueries + q]);
    EXPECT_LE(difference(out.hidden[0], layer0, b * kQueries * kWidth), kTolerance);
    for (std::size_t i = 0; i < 3; ++i) {
      EXPECT_LE(difference(out.hidden[i], hidden, (2 * i + b) * kQueries * kWidth), kTolerance);
      EXPECT_LE(difference(out.cls[i], cls, (2 * i + b) * kQueries), kTolerance);
      EXPECT_LE(difference(out.kpt[i], kpt, (2 * i + b) * kQueries * 42), kTolerance);
    }
    for (std::size_t j = 0; j < 2; ++j)
      EXPECT_LE(difference(out.refined[j], refined, (2 * j + b) * kQueries * 42), kTolerance);
  }
}

TEST_F(GoldenDecoder, RefinementWithoutIdentityMovesEverybodyAlike) {
  CSIPOSE_NEEDS_SHARED_DATA();
  const DecoderOutput out = run(0);
  for (std::size_t i = 0; i < 42; ++i)
    for (std::size_t q = 1; q < kQueries; ++q)
      EXPECT_NEAR(out.refined[1].at(q, i) - out.kpt[2].at(q, i),
                  out.refined[1].at(0, i) - out.kpt[2].at(0, i), 1e-6);
}

TEST(Reference, TokenHasTheChannelsOfItsSampleAndLink) {
  std::vector<float> x(kChannels * kTokens);
  for (std::size_t i = 0; i < x.size(); ++i) x[i] = static_cast<float>(i);
  const Matrix tokens = tokens_of(x);
  for (std::size_t c = 0; c < kChannels; ++c)
    for (std::size_t t = 0; t < kSamples; ++t)
      for (std::size_t l = 0; l < kLinks; ++l) EXPECT_EQ(tokens.at(t * 9 + l, c), x[Window::index(c, t, l)]);
}

TEST(Reference, TopRowsBreakTiesByRowAndPutNanLast) {
  Matrix scores(6, 1);
  scores.data = {1, NAN, 3, 1, 3, -HUGE_VALF};
  EXPECT_EQ(top_rows(scores, 6), (std::vector<std::size_t>{2, 4, 0, 3, 1, 5}));
  EXPECT_EQ(top_rows(scores, 3), (std::vector<std::size_t>{2, 4, 0}));
}

TEST(Reference, SoftmaxOfEqualScoresIsTheMean) {
  Matrix q(1, 4), k(3, 4), v(3, 4);
  for (std::size_t i = 0; i < v.data.size(); ++i) v.data[i] = static_cast<float>(i);
  const Matrix mixed = attention(q, k, v, 2);
  for (std::size_t c = 0; c < 4; ++c) EXPECT_FLOAT_EQ(mixed.at(0, c), 4.f + static_cast<float>(c));
}

TEST(Reference, AttentionWithHugeScoresPicksOne) {
  Matrix q(1, 2), k(2, 2), v(2, 2);
  q.data = {1e4f, 0};
  k.data = {1e4f, 0, -1e4f, 0};
  v.data = {5, 6, 7, 8};
  const Matrix mixed = attention(q, k, v, 1);
  EXPECT_EQ(mixed.at(0, 0), 5.f);
  EXPECT_EQ(mixed.at(0, 1), 6.f);
}

TEST(Reference, LayerNormGivesMeanZeroVarianceOne) {
  TensorMap weights;
  weights.add("n.weight", {{4}, {1, 1, 1, 2}});
  weights.add("n.bias", {{4}, {0, 0, 0, 1}});
  Matrix x(1, 4);
  x.data = {1, 2, 3, 4};
  const Matrix y = layer_norm(x, weights, "n", 0);
  const float unit = std::sqrt(1.25f);
  EXPECT_NEAR(y.at(0, 0), -1.5f / unit, 1e-6);
  EXPECT_NEAR(y.at(0, 1), -0.5f / unit, 1e-6);
  EXPECT_NEAR(y.at(0, 3), 2 * 1.5f / unit + 1, 1e-6);
}

TEST(Reference, GeluIsTheExactOne) {
  Matrix x(1, 3);
  x.data = {0, 1, -3};
  const Matrix y = gelu(x);
  EXPECT_EQ(y.at(0, 0), 0.f);
  EXPECT_NEAR(y.at(0, 1), 0.8413447461, 1e-7);  // Phi(1)
  EXPECT_NEAR(y.at(0, 2), -3 * 0.0013498980, 1e-7);
}

}  // namespace
}  // namespace csipose::reference
