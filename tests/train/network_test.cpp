// Networks, losses, masks, schedules and optimiser against golden values, and against the engines of the daemon.
#include "train/network.h"

#include <gtest/gtest.h>

#include <cmath>
#include <nlohmann/json.hpp>
#include <set>

#include "model/engine.h"
#include "model/model.h"
#include "proto/npy.h"
#include "proto/result.h"
#include "tests/shared_data.h"
#include "train/adamw.h"
#include "train/losses.h"
#include "train/masks.h"
#include "train/schedules.h"

namespace csipose::train {
namespace {

using csipose::testing::shared_data;

constexpr double kTolerance = 1e-4;  // of the golden networks, float32
const Numerics kPlain{};

template <class T>
at::Tensor tensor_of(const NpyArray<T>& array) {
  const std::vector<std::int64_t> sizes(array.shape.begin(), array.shape.end());
  return at::from_blob(const_cast<T*>(array.data.data()), sizes, c10::CppTypeToScalarType<T>::value).clone();
}
at::Tensor golden(const std::string& name) {
  return tensor_of(read_npy<float>(shared_data("model/" + name)));
}
at::Tensor golden_indices(const std::string& name) {
  return tensor_of(read_npy<std::int64_t>(shared_data("model/" + name)));
}
Parameters golden_weights(const std::string& name) {
  return parameters_of(SafetensorsFile::read(shared_data("model/" + name)));
}
nlohmann::json golden_json(const std::string& name) {
  std::ifstream file(shared_data("model/" + name));
  return nlohmann::json::parse(file);
}
double difference(const at::Tensor& a, const at::Tensor& b) {
  EXPECT_EQ(a.sizes(), b.sizes());
  return a.sizes() == b.sizes() ? (a.to(at::kDouble) - b.to(at::kDouble)).abs().max().item<double>()
                                : HUGE_VAL;
}

at::Tensor made_up_windows(std::int64_t count, std::uint64_t seed) {
  SeededRandom random(seed, "windows");
  at::Tensor x = at::empty({count, 60, 20, 9});
  for (std::int64_t i = 0; i < x.numel(); ++i) x.data_ptr<float>()[i] = static_cast<float>(random.normal());
  return x;
}

// ---- golden networks ----

TEST(Dropout, LeavesOutTheShareAndKeepsTheMean) {
  at::manual_seed(3);
  for (const at::ScalarType type : {at::kFloat, at::kBFloat16}) {
    const at::Tensor x = at::ones({7, 11, 1301}, type).requires_grad_(true);  // no multiple of four
    const at::Tensor y = dropout(x, 0.25);
    const auto share = [](const at::Tensor& chosen) { return chosen.to(at::kDouble).mean().item<double>(); };
    EXPECT_NEAR(share(y == 0), 0.25, 0.005);
    EXPECT_EQ(share(y == y.max()), 1 - share(y == 0));
    EXPECT_NEAR(y.max().item<double>(), 4. / 3, 0.005);
    y.sum().backward();
    EXPECT_TRUE(x.grad().equal(y.detach())) << "what was left out does not learn";
  }
  const at::Tensor x = at::rand({5, 3});
  at::manual_seed(4);
  const at::Tensor first = dropout(x, 0.5), other = dropout(x, 0.5);
  at::manual_seed(4);
  EXPECT_TRUE(first.equal(dropout(x, 0.5)));
  EXPECT_FALSE(first.equal(other));
}

TEST(Encoder, IsTheGoldenOneWithAllAndWithSomeTokens) {
  CSIPOSE_NEEDS_SHARED_DATA();
  const at::NoGradGuard no_gradients;
  const Parameters weights = golden_weights("vit_tiny/weights.safetensors");
  const at::Tensor tokens = tokens_of(golden("vit_tiny/x.npy"));
  std::vector<at::Tensor> blocks;
  const at::Tensor all = encode(weights, "", {32, 2, 4}, tokens, {}, kPlain, &blocks);
  EXPECT_LE(difference(blocks[0], golden("vit_tiny/embed.npy")), kTolerance);
  EXPECT_LE(difference(blocks[1], golden("vit_tiny/block0.npy")), kTolerance);
  EXPECT_LE(difference(all, golden("vit_tiny/out_full.npy")), kTolerance);
  const at::Tensor some =
      encode(weights, "", {32, 2, 4}, tokens, golden_indices("vit_tiny/context_idx.npy"), kPlain);
  EXPECT_LE(difference(some, golden("vit_tiny/out_context.npy")), kTolerance);
}

TEST(Encoder, PositionCodeIsTheGoldenOne) {
  CSIPOSE_NEEDS_SHARED_DATA();
  EXPECT_LE(difference(position_code(32), golden("posembed/pe_t20_l9_d32.npy")), 1e-6);
  EXPECT_LE(difference(position_code(512), golden("posembed/pe_t20_l9_d512.npy")), 1e-6);
}

TEST(FlatTokens, ArePatchesOfTheWindowAsAnImage) {
  const at::Tensor windows = made_up_windows(2, 3);
  const at::Tensor flat = flat_tokens_of(tokens_of(windows));
  ASSERT_EQ(flat.sizes(), (std::vector<std::int64_t>{2, 300, 36}));
  const auto there = flat.accessor<float, 3>();
  const auto x = windows.accessor<float, 4>();
  for (std::int64_t b = 0; b < 2; ++b)
    for (std::int64_t channel = 0; channel < 60; ++channel)
      for (std::int64_t column = 0; column < 180; ++column)
        ASSERT_EQ(there[b][channel / 6 * 30 + column / 6][channel % 6 * 6 + column % 6],
                  x[b][channel][column % 20][column / 20]);
}

TEST(FlatTokens, HaveAPositionCodeOfTheirOwnGrid) {
  const at::Tensor code = position_code(8, kFlatGrid);
  ASSERT_EQ(code.sizes(), (std::vector<std::int64_t>{300, 8}));
  const double row = 7, column = 23, slower = 0.01;  // 10000^(-1 / 2)
  const double expected[] = {
      std::sin(column), std::sin(slower * column), std::cos(column), std::cos(slower * column),
      std::sin(row),    std::sin(slower * row),    std::cos(row),    std::cos(slower * row)};
  for (std::int64_t k = 0; k < 8; ++k)
    EXPECT_NEAR(code[7 * 30 + 23][k].item<double>(), expected[k], 1e-6) << k;
}

TEST(Encoder, InBfloat16StaysNear) {
  CSIPOSE_NEEDS_SHARED_DATA();
  const at::NoGradGuard no_gradients;
  const Parameters weights = golden_weights("vit_tiny/weights.safetensors");
  const at::Tensor out =
      encode(weights, "", {32, 2, 4}, tokens_of(golden("vit_tiny/x.npy")), {}, Numerics{at::kBFloat16, 0});
  const at::Tensor full = golden("vit_tiny/out_full.npy");
  EXPECT_LE((out - full).square().mean().sqrt().item<double>(), 2e-2 * full.std().item<double>());
  EXPECT_EQ(out.scalar_type(), at::kFloat);
}

struct GoldenJepa {
  Parameters context = golden_weights("vit_tiny/weights.safetensors");
  Parameters target = golden_weights("jepa_tiny/target_encoder.safetensors");
  Parameters predictor = golden_weights("jepa_tiny/predictor.safetensors").renamed_copy("", "predictor.");
  at::Tensor tokens = tokens_of(golden("vit_tiny/x.npy"));
  at::Tensor shown = golden_indices("jepa_tiny/context_idx.npy"),
             hidden = golden_indices("jepa_tiny/target_idx.npy");
};

TEST(Predictor, AndTargetAndLossAreTheGoldenOnes) {
  CSIPOSE_NEEDS_SHARED_DATA();
  const at::NoGradGuard no_gradients;
  const GoldenJepa jepa;
  const at::Tensor z = encode(jepa.context, "", {32, 2, 4}, jepa.tokens, jepa.shown, kPlain);
  const at::Tensor predicted = predict(jepa.predictor, {24, 2, 4}, z, jepa.shown, jepa.hidden, kPlain);
  EXPECT_LE(difference(predicted, golden("jepa_tiny/pred.npy")), kTolerance);
  const at::Tensor features = encode(jepa.target, "", {32, 2, 4}, jepa.tokens, {}, kPlain);
  EXPECT_LE(difference(features, golden("jepa_tiny/target_full_raw.npy")), kTolerance);
  const at::Tensor target = normalised_target(features, jepa.hidden);
  EXPECT_LE(difference(target, golden("jepa_tiny/target_ln.npy")), kTolerance);
  const double loss = golden_json("jepa_tiny/config.json")["loss"];
  EXPECT_NEAR(prediction_loss(predicted, target).item<double>(), loss, 1e-5);
}

TEST(Predictor, DoesNotCareForTheOrderOfItsTargets) {
  const at::NoGradGuard no_gradients;
  const Parameters weights = initial_predictor({48, 1, 4}, 64, 3);
  const at::Tensor z = made_up_windows(1, 5).flatten().narrow(0, 0, 80 * 64).view({1, 80, 64});
  const at::Tensor shown = at::arange(80).view({1, 80}), hidden = at::arange(80, 180).view({1, 100});
  const at::Tensor there = predict(weights, {48, 1, 4}, z, shown, hidden, kPlain);
  const at::Tensor back = predict(weights, {48, 1, 4}, z, shown, hidden.flip(1), kPlain).flip(1);
  EXPECT_LE(difference(there, back), 1e-5);
}

TEST(Decoder, IsTheGoldenOne) {
  CSIPOSE_NEEDS_SHARED_DATA();
  const at::NoGradGuard no_gradients;
  const Parameters weights = golden_weights("decoder_tiny/weights.safetensors");
  const DecoderShape shape{4, 3, 2, false};
  const Decoded decoded = decode(weights, shape, golden("decoder_tiny/memory.npy"), kPlain);
  EXPECT_LE(difference(decoded.enc_cls, golden("decoder_tiny/enc_cls.npy")), kTolerance);
  EXPECT_LE(difference(decoded.enc_kpt, golden("decoder_tiny/enc_kpt.npy")), kTolerance);
  EXPECT_TRUE(decoded.topk.equal(golden_indices("decoder_tiny/topk_idx.npy")));
  EXPECT_LE(difference(decoded.hidden[0], golden("decoder_tiny/layer0_out.npy")), kTolerance);
  EXPECT_LE(difference(at::stack(decoded.hidden), golden("decoder_tiny/dec_hidden.npy")), kTolerance);
  EXPECT_LE(difference(at::stack(decoded.cls), golden("decoder_tiny/all_cls.npy")), kTolerance);
  EXPECT_LE(difference(at::stack(decoded.kpt), golden("decoder_tiny/all_kpt.npy")), kTolerance);
  const Refined refined = refine(weights, shape, decoded, at::arange(6).expand({2, 6}), kPlain);
  EXPECT_LE(difference(at::stack(refined.pose).view({2, 2, 6, 14, 3}), golden("decoder_tiny/refined.npy")),
            kTolerance);
}

// ---- the engines of the daemon ----

NetworkConfig micro(bool conditioned, bool sigma, bool queries = false) {
  NetworkConfig config = preset_config("micro");
  config.identity_conditioning = conditioned;
  config.query_conditioning = queries;
  config.joint_sigma = sigma;
  return config;
}

/// What training computes for a window, as an engine gives it.
struct Answer {
  at::Tensor logits, poses, sigma_m;
};
Answer answer(const NetworkConfig& config, const Parameters& weights, const at::Tensor& window, LinkSet links,
              const Numerics& numerics) {
  TokenList visible;
  for (std::int64_t token = 0; token < 180; ++token)
    if (links[static_cast<std::size_t>(token % 9)]) visible.push_back(token);
  const at::Tensor features =
      encode(weights, "encoder.", {config.dim, config.depth, config.heads}, tokens_of(window),
             at::tensor(visible, at::kLong).unsqueeze(0), numerics);
  const DecoderShape shape{config.decoder_heads, config.decoder_layers, config.refine_layers,
                           config.identity_conditioning, config.query_conditioning};
  const Decoded decoded = decode(weights, shape, memory_of(weights, features, numerics), numerics);
  const std::int64_t queries = decoded.topk.size(1);
  const Refined refined = refine(weights, shape, decoded, at::arange(queries).unsqueeze(0), numerics);
  return {decoded.cls.back().flatten(), refined.pose.back().flatten(),
          config.joint_sigma ? joint_sigma_m(weights, refined.state).flatten() : at::Tensor()};
}

at::Tensor tensor_of(std::span<const float> numbers) {
  return at::from_blob(const_cast<float*>(numbers.data()), {static_cast<std::int64_t>(numbers.size())})
      .clone();
}

void expect_parity(const std::shared_ptr<const Model>& model, Engine& engine, LinkSet links) {
  const at::NoGradGuard no_gradients;
  const Parameters weights =
      parameters_of(SafetensorsFile::parse(random_weights(model->config(), 11, HeadInit::random), "micro"));
  const at::Tensor window = made_up_windows(1, 7);
  const NetworkOutput theirs = engine.run({window.data_ptr<float>(), 60 * 20 * 9}, links);
  const Answer ours = answer(model->config(), weights, window, links, kPlain);
  EXPECT_LE(difference(ours.poses, tensor_of(theirs.poses)), kTolerance) << engine.describe();
  EXPECT_LE(difference(ours.logits, tensor_of(theirs.logits)), kTolerance) << engine.describe();
  if (model->config().joint_sigma) {
    EXPECT_LE(difference(ours.sigma_m, tensor_of(theirs.sigma_m)), kTolerance) << engine.describe();
  }
}

TEST(Parity, EnginesOfTheDaemonGiveTheSamePoses) {
  for (const NetworkConfig& config :
       {micro(true, true), micro(false, false), micro(true, true, /*queries=*/true)}) {
    const auto model = init_random(config, 11, HeadInit::random);
    OneDnnOptions options;
    options.precision = Precision::f32;
    options.refined_queries = 0;
    const auto reference = make_reference_engine(model), fast = make_onednn_engine(model, options);
    for (const LinkSet links : {LinkSet(0x1ff), LinkSet(0x1c7)}) {
      expect_parity(model, *reference, links);
      expect_parity(model, *fast, links);
    }
  }
}

TEST(Parity, TrainedNumbersGoThroughTheFileUnchanged) {
  const Parameters initial = initial_network(micro(true, false), 4);
  std::vector<at::Tensor> kept;
  const auto bytes = pack_safetensors({}, views_of(initial, kept));
  const Parameters read = parameters_of(SafetensorsFile::parse(bytes, "file"));
  ASSERT_EQ(read.size(), initial.size());
  for (const auto& [name, tensor] : initial) EXPECT_TRUE(read[name].equal(tensor)) << name;
}

TEST(Parameters, OfEveryPresetAreAsManyAsThePaperSays) {
  EXPECT_EQ(static_cast<std::int64_t>(parameter_count(preset_config("paper"))), 46'297'266 + 65'792);
  std::size_t predictor = 0;
  for (const TensorSpec& spec : predictor_tensors(predictor_shape("paper"), 512)) {
    std::size_t count = 1;
    for (const std::size_t size : spec.shape) count *= size;
    predictor += count;
  }
  EXPECT_EQ(predictor, 25'745'920u);
  EXPECT_THROW(predictor_shape("huge"), SetupError);
}

// ---- losses ----

struct GoldenSet {
  at::Tensor logits = golden("set_loss/logits.npy"), kpts = golden("set_loss/kpts.npy");
  People people;
  nlohmann::json expected = golden_json("set_loss/expected.json");
  GoldenSet() {
    people.poses = at::zeros({3, 3, 42});
    for (std::int64_t b = 0; b < 3; ++b) {
      const at::Tensor there = golden("set_loss/gt_" + std::to_string(b) + ".npy");
      people.count.push_back(there.size(0));
      people.poses[b].narrow(0, 0, there.size(0)).copy_(there.view({there.size(0), 42}));
    }
  }
};

TEST(SetLoss, CostsAndMatchesAreTheGoldenOnes) {
  CSIPOSE_NEEDS_SHARED_DATA();
  const GoldenSet set;
  const at::Tensor cost = matching_cost(set.logits, set.kpts, set.people.poses, {});
  const Matches matches = match(set.logits, set.kpts, set.people, {});
  std::set<std::array<std::int64_t, 3>> pairs, golden_pairs;
  for (std::size_t i = 0; i < matches.size(); ++i)
    pairs.insert({matches.window[i], matches.query[i], matches.person[i]});
  for (std::int64_t b = 0; b < 3; ++b) {
    const auto& image = set.expected["images"][static_cast<std::size_t>(b)];
    const std::int64_t there = set.people.count[static_cast<std::size_t>(b)];
    for (std::int64_t q = 0; q < 7; ++q)
      for (std::int64_t m = 0; m < there; ++m)
        EXPECT_NEAR(cost[b][q][m].item<double>(),
                    image["cost"][static_cast<std::size_t>(q * there + m)].get<double>(), 1e-4);
    for (std::size_t i = 0; i < image["rows"].size(); ++i)
      golden_pairs.insert({b, image["rows"][i].get<std::int64_t>(), image["cols"][i].get<std::int64_t>()});
  }
  EXPECT_EQ(pairs, golden_pairs);
}

TEST(SetLoss, LossesAreTheGoldenOnes) {
  CSIPOSE_NEEDS_SHARED_DATA();
  const GoldenSet set;
  const Matches matches = match(set.logits, set.kpts, set.people, {});
  const double people = static_cast<double>(matches.size());
  const double cls = 4 * focal_sum(set.logits, matches).item<double>() / people;
  const double kpt = 70 * pose_error_sum(set.kpts, matches, set.people, {}).item<double>() / (42 * people);
  EXPECT_NEAR(cls, set.expected["loss_cls"].get<double>(), 1e-5 * cls);
  EXPECT_NEAR(kpt, set.expected["loss_kpt"].get<double>(), 1e-5 * kpt);
}

TEST(Decoder, ATokenStandsForThoseThatWereLeftOut) {
  const Parameters weights = initial_network(preset_config("micro"), 1);
  const DecoderShape shape = decoder_shape(preset_config("micro"));
  at::manual_seed(1);
  // Heads begin with a last layer of zeros, and all proposals alike.
  for (const auto& [name, tensor] : weights)
    if (name.rfind("kpt_branches.", 0) == 0) tensor.normal_(0, 0.3);
  const at::Tensor one = at::randn({2, 9, 64});
  const at::Tensor alike = one.repeat({1, 4, 1});  // four samples that look the same
  const Decoded few = decode(weights, shape, one, kPlain, 0.25), all = decode(weights, shape, alike, kPlain);
  for (std::size_t i = 0; i < all.kpt.size(); ++i) EXPECT_LE(difference(few.kpt[i], all.kpt[i]), 1e-3);
  EXPECT_GT(difference(decode(weights, shape, one, kPlain).kpt[0], all.kpt[0]), 0.1);
}

constexpr SetLossWeights kDistance{.error = PoseError::distance};

TEST(SetLoss, ErrorsOfAPoseThatIsOffByTheSameEverywhere) {
  const People people{at::zeros({1, 1, 42}), {1}};
  const Matches first{{0}, {1}, {0}};
  at::Tensor kpt = at::zeros({1, 2, 42});
  kpt[0][1].view({14, 3}).copy_(at::tensor({2.f, 3.f, 6.f}));  // 7 m
  EXPECT_NEAR(pose_error_sum(kpt, first, people, {}).item<double>(), 14 * 49, 1e-3);
  kpt.requires_grad_(true);
  const at::Tensor distance = pose_error_sum(kpt, first, people, kDistance);
  EXPECT_NEAR(distance.item<double>(), 14 * 7, 1e-3);
  distance.backward();
  EXPECT_NEAR(kpt.grad()[0][1][41].item<double>(), 6. / 7, 1e-5);  // the direction, however far
  EXPECT_EQ(kpt.grad()[0][0].abs().sum().item<double>(), 0);
  at::Tensor exact = at::zeros({1, 2, 42}).requires_grad_(true);
  pose_error_sum(exact, first, people, kDistance).backward();
  EXPECT_TRUE(exact.grad().isfinite().all().item<bool>());
}

TEST(SetLoss, WhatIsOffAboutTheRootCountsApart) {
  const People people{at::zeros({1, 1, 42}), {1}};
  const Matches first{{0}, {0}, {0}};
  SetLossWeights weights;
  weights.error = PoseError::distance;
  weights.root_relative = 0.5;
  at::Tensor moved = at::zeros({1, 1, 42});
  moved[0][0].view({14, 3}).copy_(
      at::tensor({2.f, 3.f, 6.f}));  // all of one by 7 m: as it should be about its root
  EXPECT_NEAR(pose_error_sum(moved, first, people, weights).item<double>(), 14 * 7, 0.02);
  at::Tensor arm = at::zeros({1, 1, 42});
  arm[0][0][3 * 10] = 0.4f;  // a hand, 0.4 m along x: it counts half again
  EXPECT_NEAR(pose_error_sum(arm, first, people, weights).item<double>(), 1.5 * 0.4, 0.03);
  at::Tensor hips = at::zeros({1, 1, 42});
  for (const std::size_t hip : {kLeftHip, kRightHip}) hips[0][0][static_cast<std::int64_t>(3 * hip)] = 0.1f;
  // The root went with the hips: seen from it, the twelve others are off.
  EXPECT_NEAR(pose_error_sum(hips, first, people, weights).item<double>(), 2 * 0.1 + 0.5 * 12 * 0.1, 0.03);
  weights.root_relative = 0;
  EXPECT_EQ(pose_error_sum(hips, first, people, weights).item<double>(),
            pose_error_sum(hips, first, people, kDistance).item<double>());
  weights.error = PoseError::squared;
  weights.root_relative = 2;
  EXPECT_NEAR(pose_error_sum(hips, first, people, weights).item<double>(), 2 * 0.01 + 2 * 12 * 0.01, 1e-6);
}

TEST(SetLoss, AWindowWithoutPeopleIsAllBackground) {
  People nobody{at::zeros({2, 0, 42}), {0, 0}};
  const at::Tensor logits = at::full({2, 8, 1}, -4.f), poses = at::zeros({2, 8, 42});
  const Matches matches = match(logits, poses, nobody, {});
  EXPECT_EQ(matches.size(), 0u);
  EXPECT_EQ(pose_error_sum(poses, matches, nobody, kDistance).item<double>(), 0);
  EXPECT_GT(focal_sum(logits, matches).item<double>(), 0);
}

/// Poses (1, people, 42) whose hips are at these places of the floor.
at::Tensor standing_at(const std::vector<std::pair<float, float>>& places) {
  at::Tensor poses = at::zeros({1, static_cast<std::int64_t>(places.size()), kPoseWidth});
  for (std::size_t p = 0; p < places.size(); ++p)
    for (const std::size_t hip : {kLeftHip, kRightHip}) {
      poses[0][p][3 * hip] = places[p].first;
      poses[0][p][3 * hip + 1] = places[p].second;
    }
  return poses;
}

TEST(FloorGrid, CoversTheRootsInWholeMetres) {
  const at::Tensor roots =
      at::tensor({0.5f, 1.f, 0.9f, 4.2f, 1.1f, -1.4f}).view({2, 3});  // along axes 0 and 2
  const FloorGrid grid = FloorGrid::around(roots);
  EXPECT_EQ(grid.axis_x, 0);
  EXPECT_EQ(grid.axis_y, 2);
  EXPECT_EQ(grid.least_x_m, 0);
  EXPECT_EQ(grid.least_y_m, -2);
  EXPECT_EQ(grid.columns, 5 * 4);
  EXPECT_EQ(grid.rows, 4 * 4);
  const at::Tensor middles = grid.middles();
  ASSERT_EQ(middles.size(0), grid.cells());
  EXPECT_FLOAT_EQ(middles[1][0].item<float>(), 0.125);
  EXPECT_FLOAT_EQ(middles[1][1].item<float>(), -2 + 0.375);
  EXPECT_FLOAT_EQ(middles[16][0].item<float>(), 0.375);
}

// With the last layer's weights 0 every cell is said to be taken with the same probability p; the loss is then a sum of
// entropies that a few lines give.
TEST(MapLoss, IsTheCrossEntropyOfWhatIsWanted) {
  FloorGrid grid;
  grid.columns = 12;
  grid.rows = 8;
  Parameters head = initial_map_head(16, 96, 1);
  head["predictor.map.2.weight"].zero_();
  head["predictor.map.2.bias"].fill_(-1.5);
  const double p = 1 / (1 + std::exp(1.5));
  const std::vector<std::pair<float, float>> places = {{1.1f, 0.4f}, {2.6f, 1.7f}};
  People people;
  people.poses = standing_at(places);
  for (const std::int64_t there : {0, 1, 2}) {
    people.count = {there};
    double expected = 0;
    for (int column = 0; column < 12; ++column)
      for (int row = 0; row < 8; ++row) {
        double wanted = 0;
        for (int i = 0; i < there; ++i) {
          const double x = 0.25 * column + 0.125 - static_cast<double>(places[i].first),
                       y = 0.25 * row + 0.125 - static_cast<double>(places[i].second);
          wanted = std::max(wanted, std::exp(-(x * x + y * y) / (2 * 0.25 * 0.25)));
        }
        expected -= wanted * std::log(p) + (1 - wanted) * std::log(1 - p);
      }
    const at::Tensor loss = map_loss(head, at::randn({1, 20, 16}), people, grid);
    EXPECT_NEAR(loss.item<double>(), expected, 1e-3) << there;
  }
}

TEST(PredictionLoss, IsZeroWhenPredictionIsTarget) {
  const at::Tensor x = made_up_windows(1, 2);
  EXPECT_EQ(prediction_loss(x, x).item<double>(), 0);
}

// ---- masks ----

TEST(Masks, TokensOfLinksAndTimesAreTheGoldenOnes) {
  CSIPOSE_NEEDS_SHARED_DATA();
  const auto golden_masks = golden_json("masks/cases.json");
  for (const auto& one : golden_masks["cases"]) {
    const TokenList of_links = tokens_of_columns(one["links"].get<std::vector<std::size_t>>());
    const TokenList of_times = tokens_of_times(one["times"].get<std::vector<std::size_t>>());
    EXPECT_EQ(of_links, one["link_target"].get<TokenList>());
    EXPECT_EQ(other_tokens(of_links), one["link_context"].get<TokenList>());
    EXPECT_EQ(of_times, one["time_target"].get<TokenList>());
    EXPECT_EQ(other_tokens(of_times), one["time_context"].get<TokenList>());
  }
}

constexpr std::array<std::uint64_t, 6> kSamplesDrawn = {0, 1, 2, 3, 100, 101};

TEST(Masks, HideWhatTheirNamesSay) {
  const std::map<Masking, std::size_t> hidden = {
      {Masking::link, 100}, {Masking::time, 108}, {Masking::random, 108}, {Masking::block, 108}};
  for (const auto& [masking, count] : hidden) {
    const BatchMasks masks = draw_masks(masking, 1, 2, kSamplesDrawn);
    for (std::size_t i = 0; i < kSamplesDrawn.size(); ++i) {
      EXPECT_EQ(masks.targets[0][i].size(), count);
      EXPECT_TRUE(std::is_sorted(masks.targets[0][i].begin(), masks.targets[0][i].end()));
      EXPECT_EQ(masks.context[i], other_tokens(masks.targets[0][i]));
    }
    EXPECT_NE(masks.targets[0][0], masks.targets[0][1]);
  }
}

TEST(Masks, OfAnEpochAndSampleDoNotDependOnTheBatch) {
  for (const Masking masking : {Masking::link, Masking::time, Masking::random, Masking::block}) {
    const std::array<std::uint64_t, 1> alone = {100};
    EXPECT_EQ(draw_masks(masking, 1, 2, alone).targets[0][0],
              draw_masks(masking, 1, 2, kSamplesDrawn).targets[0][4]);
    EXPECT_NE(draw_masks(masking, 1, 3, alone).targets[0][0], draw_masks(masking, 1, 2, alone).targets[0][0]);
  }
}

TEST(Masks, OfReceiverTokensHideWholeReceiversOrSamples) {
  std::set<std::int64_t> shown;
  for (const auto& [masking, hidden] : {std::pair{Masking::link, 40u}, std::pair{Masking::time, 36u}}) {
    const BatchMasks masks = draw_receiver_masks(masking, 1, 2, kSamplesDrawn);
    for (std::size_t i = 0; i < kSamplesDrawn.size(); ++i) {
      ASSERT_EQ(masks.targets[0][i].size(), hidden);
      EXPECT_TRUE(std::is_sorted(masks.targets[0][i].begin(), masks.targets[0][i].end()));
      EXPECT_EQ(masks.context[i], other_tokens(masks.targets[0][i], 60));
      for (const std::int64_t token : masks.context[i]) {
        if (masking == Masking::link) {
          EXPECT_EQ(token % 3, masks.context[i].front() % 3) << "one receiver is seen";
        } else {
          EXPECT_EQ(std::ranges::count(masks.context[i], token / 3 * 3 + 2), 1) << "all of a sample are";
        }
      }
      if (masking == Masking::link) shown.insert(masks.context[i].front() % 3);
    }
    EXPECT_EQ(draw_receiver_masks(masking, 1, 2, std::array<std::uint64_t, 1>{100}).targets[0][0],
              masks.targets[0][4]);
  }
  EXPECT_GT(shown.size(), 1u);
  EXPECT_THROW(draw_receiver_masks(Masking::random, 1, 2, kSamplesDrawn), SetupError);
}

TEST(Masks, OfFlatTokensHideTheColumnsThatFiveLinksOwn) {
  // Samples 60 to 119 are those of links 3, 4 and 5: a third column and a seventh lie across two of them.
  for (const auto& [link, first, last] : {std::array{0, 0, 2}, std::array{3, 10, 12}, std::array{4, 13, 16},
                                          std::array{5, 17, 19}, std::array{8, 27, 29}}) {
    TokenList expected;
    for (int row = 0; row < 10; ++row)
      for (int column = first; column <= last; ++column) expected.push_back(row * 30 + column);
    EXPECT_EQ(flat_tokens_of_links(std::array{static_cast<std::size_t>(link)}), expected) << link;
  }
  std::set<std::size_t> sizes;
  for (std::uint64_t epoch = 0; epoch < 40; ++epoch) {
    const BatchMasks masks = draw_flat_masks(1, epoch, kSamplesDrawn);
    sizes.insert(masks.targets[0][0].size());
    for (std::size_t i = 0; i < kSamplesDrawn.size(); ++i) {
      ASSERT_EQ(masks.targets[0][i].size(), masks.targets[0][0].size());
      EXPECT_EQ(masks.context[i], other_tokens(masks.targets[0][i], 300));
      std::set<std::int64_t> columns;
      for (const std::int64_t token : masks.targets[0][i]) columns.insert(token % 30);
      std::size_t links = 0;
      for (std::size_t link = 0; link < kLinks; ++link)
        links += columns.count(flat_tokens_of_links(std::array{link}).front() % 30);
      EXPECT_EQ(links, 5u);
    }
  }
  EXPECT_EQ(sizes, (std::set<std::size_t>{150, 160, 170, 180}))
      << "none to three of the links that own four columns";
}

TEST(Masks, OfIjepaShareOneSizeAndKeepContextApartFromTargets) {
  const BatchMasks masks = draw_masks(Masking::ijepa, 5, 0, kSamplesDrawn);
  ASSERT_EQ(masks.targets.size(), 4u);
  for (std::size_t i = 0; i < kSamplesDrawn.size(); ++i) {
    EXPECT_EQ(masks.context[i].size(), masks.context[0].size());
    EXPECT_GT(masks.context[i].size(), 10u);
    std::set<std::int64_t> shown(masks.context[i].begin(), masks.context[i].end());
    for (const auto& target : masks.targets) {
      EXPECT_EQ(target[i].size(), masks.targets[0][0].size());
      for (const std::int64_t token : target[i]) EXPECT_EQ(shown.count(token), 0u);
    }
  }
}

// ---- schedules, optimiser, target ----

TEST(Schedules, AreTheGoldenOnes) {
  CSIPOSE_NEEDS_SHARED_DATA();
  std::ifstream file(shared_data("model/schedules/schedules.csv"));
  std::string line;
  std::getline(file, line);
  std::uint64_t rows = 0;
  for (std::uint64_t step = 1; std::getline(file, line); ++step, ++rows) {
    std::array<double, 6> row{};
    std::replace(line.begin(), line.end(), ',', ' ');
    std::istringstream words(line);
    for (double& number : row) words >> number;
    const std::array<double, 6> ours = {static_cast<double>(step),
                                        WarmUpCosine{1e-4, 5e-4, 1e-6}.at(step, 100, 1000),
                                        0.05,
                                        half_cosine(0.04, 0.4, step, 1000),
                                        momentum_cosine(0.996, step, 1000),
                                        momentum_linear(0.996, step, 1000)};
    for (std::size_t i = 0; i < row.size(); ++i)
      ASSERT_NEAR(ours[i], row[i], 1e-12 * row[i]) << step << ' ' << i;
  }
  EXPECT_EQ(rows, 1000u);
}

TEST(Target, MovesAsTheGoldenOne) {
  CSIPOSE_NEEDS_SHARED_DATA();
  const GoldenJepa jepa;
  const Parameters moved = golden_weights("jepa_tiny/ema_after_one_step.safetensors");
  follow(jepa.target, "", jepa.context, "", 0.996);
  for (const auto& [name, tensor] : moved) EXPECT_LE(difference(jepa.target[name], tensor), 1e-7) << name;
}

TEST(AdamW, MakesTheStepsOfItsFormula) {
  Parameters one;
  one.set("x", at::full({1}, 2.f));
  AdamW optimiser({{one, 0.5, 0.1}});
  double x = 2, mean = 0, square = 0;
  for (int step = 1; step <= 3; ++step) {
    const double gradient = 3 * x * x;
    one["x"].mutable_grad() = at::full({1}, gradient);
    optimiser.step(0.02);
    x *= 1 - 0.01 * 0.1;
    mean = 0.9 * mean + 0.1 * gradient;
    square = 0.999 * square + 0.001 * gradient * gradient;
    x -= 0.01 * mean / (1 - std::pow(0.9, step)) / (std::sqrt(square / (1 - std::pow(0.999, step))) + 1e-8);
    EXPECT_NEAR(one["x"].item<double>(), x, 1e-6);
  }
}

TEST(AdamW, ClipsTheNormOfAllGradientsTogether) {
  Parameters two;
  two.set("a", at::zeros({1}));
  two.set("b", at::zeros({1}));
  AdamW optimiser({{two, 1, 0}});
  two["a"].mutable_grad() = at::full({1}, 3.f);
  two["b"].mutable_grad() = at::full({1}, 4.f);
  EXPECT_NEAR(optimiser.clip_gradients(0.1), 5, 1e-6);
  EXPECT_NEAR(optimiser.gradient_norm(), 0.1, 1e-6);
}

}  // namespace
}  // namespace csipose::train
