// The whole network as an engine: what must hold for any weights.
#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <map>
#include <optional>

#include "model/engine.h"
#include "model/model.h"
#include "model/reference.h"
#include "tests/model/made_up_background.h"

namespace csipose {
namespace {

std::vector<float> input(unsigned seed) {
  std::vector<float> x(kChannels * kTokens);
  for (std::size_t i = 0; i < x.size(); ++i)
    x[i] = std::sin(0.1f * static_cast<float>(seed) + 0.731f * static_cast<float>(i));
  return x;
}
LinkSet all_links() { return LinkSet().set(); }
std::vector<float> copy(std::span<const float> view) { return {view.begin(), view.end()}; }

std::shared_ptr<const Model> micro(bool identity = true, bool sigma = false) {
  NetworkConfig config = preset_config("micro");
  config.identity_conditioning = identity;
  config.joint_sigma = sigma;
  return init_random(config, 5, HeadInit::random);
}

TEST(ReferenceEngine, SameInputSameBits) {
  const auto a = make_reference_engine(micro()), b = make_reference_engine(micro());
  const auto x = input(1);
  const std::vector<float> first = copy(a->run(x, all_links()).poses);
  a->run(input(2), all_links());
  EXPECT_EQ(first, copy(a->run(x, all_links()).poses));
  EXPECT_EQ(first, copy(b->run(x, all_links()).poses));
}

TEST(ReferenceEngine, OutputDependsOnTheInput) {
  const auto engine = make_reference_engine(micro());
  const std::vector<float> first = copy(engine->run(input(1), all_links()).poses);
  EXPECT_NE(first, copy(engine->run(input(2), all_links()).poses));
}

TEST(ReferenceEngine, AbsentLinksHaveNoSay) {
  const auto engine = make_reference_engine(micro());
  LinkSet links = all_links();
  links.reset(3).reset(4).reset(5);
  std::vector<float> x = input(1);
  const std::vector<float> first = copy(engine->run(x, links).poses);
  for (std::size_t c = 0; c < kChannels; ++c)
    for (std::size_t t = 0; t < kSamples; ++t)
      for (const std::size_t l : {3, 4, 5}) x[Window::index(c, t, l)] = NAN;
  EXPECT_EQ(first, copy(engine->run(x, links).poses));
}

TEST(ReferenceEngine, AbsentLinksAreTokensLeftOutOfTheSequence) {
  const auto model = micro();
  const auto engine = make_reference_engine(model);
  const LinkSet links(0b000111000);
  const auto x = input(3);
  engine->run(x, links);
  const NetworkConfig& c = model->config();
  const std::vector<std::size_t> visible = c.tokens_there(links);
  ASSERT_EQ(visible.size(), 60u);
  const auto encoded = reference::encode(model->tensors(), "encoder.", {c.dim, c.depth, c.heads},
                                         reference::tokens_of(x), visible);
  EXPECT_EQ(encoded.tokens.data, copy(engine->stage("encoder")));
  EXPECT_EQ(engine->stage("memory").size(), 60 * c.decoder_dim);
}

// Permuting links together with their rows of the position code permutes the tokens: attention knows no
// order.
TEST(ReferenceEngine, TokensKnowTheirPlaceOnlyByThePositionCode) {
  const auto model = micro();
  const NetworkConfig& c = model->config();
  const auto tokens = reference::tokens_of(input(4));
  std::vector<std::size_t> order = c.tokens_there(all_links());
  const auto straight =
      reference::encode(model->tensors(), "encoder.", {c.dim, c.depth, c.heads}, tokens, order);
  for (std::size_t i = 0; i < order.size(); ++i) order[i] = i / 9 * 9 + (4 * (i % 9) + 2) % 9;
  const auto permuted =
      reference::encode(model->tensors(), "encoder.", {c.dim, c.depth, c.heads}, tokens, order);
  for (std::size_t i = 0; i < order.size(); ++i)
    for (std::size_t d = 0; d < c.dim; ++d)
      EXPECT_NEAR(permuted.tokens.at(i, d), straight.tokens.at(order[i], d), 1e-5);
}

TEST(ReferenceEngine, WithFewTokensThereAreAsManyQueriesAsTokens) {
  NetworkConfig config = preset_config("micro");
  config.preset = "custom";
  config.queries = 50;
  const auto engine = make_reference_engine(init_random(config, 2, HeadInit::random));
  const auto x = input(1);
  EXPECT_EQ(engine->run(x, all_links()).logits.size(), 50u);
  const NetworkOutput one_link = engine->run(x, LinkSet(1));
  EXPECT_EQ(one_link.logits.size(), 20u);
  EXPECT_EQ(one_link.poses.size(), 20 * kPoseWidth);
}

TEST(ReferenceEngine, QueriesComeInTheOrderOfTheirProposals) {
  const auto engine = make_reference_engine(micro());
  engine->run(input(1), all_links());
  const auto scores = engine->stage("enc_cls"), rows = engine->stage("topk");
  for (std::size_t q = 1; q < rows.size(); ++q)
    EXPECT_GE(scores[static_cast<std::size_t>(rows[q - 1])], scores[static_cast<std::size_t>(rows[q])]);
}

/// Spread over the queries of what refinement adds to a pose, summed over the joints' coordinates.
float refinement_spread(Engine& engine) {
  const NetworkOutput out = engine.run(input(1), all_links());
  const auto kpt = engine.stage("kpt");
  const std::size_t queries = out.logits.size();
  const auto last = kpt.subspan(kpt.size() - queries * kPoseWidth);
  float spread = 0;
  for (std::size_t i = 0; i < kPoseWidth; ++i)
    for (std::size_t q = 1; q < queries; ++q)
      spread +=
          std::fabs((out.poses[q * kPoseWidth + i] - last[q * kPoseWidth + i]) - (out.poses[i] - last[i]));
  return spread;
}

TEST(ReferenceEngine, OnlyIdentityConditioningTellsPeopleApart) {
  EXPECT_LT(refinement_spread(*make_reference_engine(micro(false))), 1e-3f);
  EXPECT_GT(refinement_spread(*make_reference_engine(micro(true))), 1.f);
}

TEST(ReferenceEngine, ZeroIdentityWeightsAreParity) {
  const auto with = init_random(preset_config("micro"), 5, HeadInit::zero);
  NetworkConfig config = preset_config("micro");
  config.identity_conditioning = false;
  const auto without = init_random(config, 5, HeadInit::zero);
  const auto a = make_reference_engine(with), b = make_reference_engine(without);
  EXPECT_EQ(copy(a->run(input(1), all_links()).poses), copy(b->run(input(1), all_links()).poses));
}

TEST(ReferenceEngine, QueriesThatSeeTheirProposalsAnswerOtherwise) {
  NetworkConfig config = preset_config("micro");
  config.query_conditioning = true;
  const auto poses = [](const NetworkConfig& of, HeadInit heads) {
    return copy(make_reference_engine(init_random(of, 5, heads))->run(input(1), all_links()).poses);
  };
  EXPECT_EQ(poses(config, HeadInit::zero), poses(preset_config("micro"), HeadInit::zero))
      << "weights of 0 say nothing";
  EXPECT_NE(poses(config, HeadInit::random), poses(preset_config("micro"), HeadInit::random));
}

/// Micro weights against `background`, and the same whose tokens also tell its mobility: each number of it is added to each of the
/// embedding, times `weight`.
std::vector<float> embedding_of(const Background& background, const std::vector<float>& x,
                                std::optional<float> weight) {
  NetworkConfig config = preset_config("micro");
  const auto plain = SafetensorsFile::parse(random_weights(config, 5, HeadInit::random), "plain");
  std::vector<TensorView> tensors = plain.tensors();
  std::map<std::string, std::string> metadata = plain.metadata();
  std::vector<float> wide;
  if (weight) {
    config.background_conditioning = true;
    metadata["config"] = to_json(config);
    for (TensorView& view : tensors) {
      if (view.name != "encoder.patch_embed.proj.weight") continue;
      const std::vector<float> narrow = to_floats(view);
      for (std::size_t row = 0; row < config.dim; ++row) {
        wide.insert(wide.end(), &narrow[row * kChannels], &narrow[row * kChannels] + kChannels);
        wide.insert(wide.end(), kChannels, *weight);
      }
      view.shape[1] = 2 * kChannels;
      view.bytes = ByteView(wide.data(), wide.size() * sizeof(float));
    }
  }
  const auto engine =
      make_reference_engine(testing::with_backgrounds(pack_safetensors(metadata, tensors), {background}));
  engine->run(x, all_links());
  return copy(engine->stage("embed"));
}

TEST(ReferenceEngine, TokensMayTellOfTheBackground) {
  const Background hall = testing::made_up_background("hall", 2);
  const std::vector<float> x = testing::window_before(hall, 1), plain = embedding_of(hall, x, {}),
                           told = embedding_of(hall, x, 0.5f);
  EXPECT_EQ(embedding_of(hall, x, 0.f), plain);
  const auto moves = mobility(hall);
  std::array<double, kLinks> sums{};
  for (std::size_t e = 0; e < kElements; ++e) sums[e % kLinks] += static_cast<double>(moves[e]);
  const std::size_t dim = plain.size() / kTokens;
  for (std::size_t i = 0; i < plain.size(); ++i)
    ASSERT_NEAR(told[i] - plain[i], 0.5 * sums[i / dim % kLinks], 1e-4) << i;
}

// An embedding that has the same weights for each of a receiver's links, and a position code that is the receivers' own: the
// embedding is the sum of what those links would have been embedded as.
TEST(ReferenceEngine, AReceiversTokenIsOfItsLinks) {
  NetworkConfig config = preset_config("micro");
  const auto plain = SafetensorsFile::parse(random_weights(config, 5, HeadInit::random), "plain");
  std::vector<TensorView> tensors = plain.tensors();
  std::map<std::string, std::string> metadata = plain.metadata();
  config.receiver_tokens = true;
  metadata["config"] = to_json(config);
  std::vector<float> wide, bias;
  for (TensorView& view : tensors) {
    if (view.name == "encoder.patch_embed.proj.bias") bias = to_floats(view);
    if (view.name != "encoder.patch_embed.proj.weight") continue;
    const std::vector<float> narrow = to_floats(view);
    for (std::size_t row = 0; row < config.dim; ++row)
      for (std::size_t a = 0; a < kAntennas; ++a)
        wide.insert(wide.end(), &narrow[row * kChannels], &narrow[row * kChannels] + kChannels);
    view.shape[1] = kAntennas * kChannels;
    view.bytes = ByteView(wide.data(), wide.size() * sizeof(float));
  }
  const auto of_links = make_reference_engine(Model::from(plain)),
             of_receivers = make_reference_engine(
                 Model::from(SafetensorsFile::parse(pack_safetensors(metadata, tensors), "wide")));
  const auto x = input(3);
  const auto link_code = reference::position_code(config.dim),
             receiver_code = reference::position_code(config.dim, kReceiverGrid);
  for (const LinkSet links : {all_links(), LinkSet(0b111000101)}) {
    of_links->run(x, links);
    of_receivers->run(x, links);
    const std::vector<float> one = copy(of_links->stage("embed")), three = copy(of_receivers->stage("embed"));
    const std::vector<std::size_t> there = config.tokens_there(links);
    ASSERT_EQ(three.size(), there.size() * config.dim);
    std::size_t row = 0;
    for (std::size_t i = 0; i < there.size(); ++i)
      for (std::size_t a = 0, first = row; a < kAntennas; ++a) {
        const std::size_t link = there[i] / kReceivers * kLinks + there[i] % kReceivers * kAntennas + a;
        if (links[link % kLinks]) ++row;
        if (a + 1 < kAntennas) continue;
        for (std::size_t d = 0; d < config.dim; ++d) {
          double expected = static_cast<double>(receiver_code.at(there[i], d) + bias[d]);
          for (std::size_t b = 0, at = first; b < kAntennas; ++b) {
            const std::size_t token = link - a + b;
            if (!links[token % kLinks]) continue;
            expected += static_cast<double>(one[at++ * config.dim + d] - link_code.at(token, d) - bias[d]);
          }
          ASSERT_NEAR(three[i * config.dim + d], expected, 1e-5) << links << ' ' << i;
        }
      }
  }
}

TEST(ReferenceEngine, SigmaIsAboveAMillimetreAndOnlyThereWithItsHead) {
  EXPECT_TRUE(make_reference_engine(micro())->run(input(1), all_links()).sigma_m.empty());
  const auto engine = make_reference_engine(micro(true, true));
  const NetworkOutput out = engine->run(input(1), all_links());
  ASSERT_EQ(out.sigma_m.size(), out.logits.size() * kJoints);
  for (const float sigma : out.sigma_m) EXPECT_GT(sigma, 1e-3f);
}

TEST(ReferenceEngine, NormalisesAmplitudeAndPhase) {
  const auto file =
      SafetensorsFile::parse(random_weights(preset_config("micro"), 5, HeadInit::random), "plain");
  std::vector<TensorView> tensors = file.tensors();
  const float mean = 20, amp_std = 5, ph_std = 1.5f;
  for (TensorView& view : tensors) {
    if (view.name == "norm.amp_mean") view.bytes = ByteView(&mean, 4);
    if (view.name == "norm.amp_std") view.bytes = ByteView(&amp_std, 4);
    if (view.name == "norm.ph_std") view.bytes = ByteView(&ph_std, 4);
  }
  const auto scaled =
      Model::from(SafetensorsFile::parse(pack_safetensors(file.metadata(), tensors), "scaled"));
  const std::vector<float> x = input(1);
  std::vector<float> raw = x;
  for (std::size_t i = 0; i < raw.size(); ++i)
    raw[i] = i < raw.size() / 2 ? x[i] * amp_std + mean : x[i] * ph_std;
  const auto a = make_reference_engine(Model::from(file)), b = make_reference_engine(scaled);
  const std::vector<float> expected = copy(a->run(x, all_links()).poses),
                           got = copy(b->run(raw, all_links()).poses);
  for (std::size_t i = 0; i < expected.size(); ++i) EXPECT_NEAR(got[i], expected[i], 1e-4);
}

TEST(ReferenceEngine, NanInputGivesAnAnswerOfTheRightSize) {
  const auto engine = make_reference_engine(micro());
  std::vector<float> x = input(1);
  x[17] = NAN;
  EXPECT_EQ(engine->run(x, all_links()).poses.size(), 8 * kPoseWidth);
}

TEST(ReferenceEngine, UnknownStageIsEmpty) {
  const auto engine = make_reference_engine(micro());
  engine->run(input(1), all_links());
  EXPECT_TRUE(engine->stage("nothing").empty());
  EXPECT_EQ(engine->stage("embed").size(), kTokens * 64);
}

}  // namespace
}  // namespace csipose
