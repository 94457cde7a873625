#include "model/onnx_graph.h"

#include <gtest/gtest.h>
#include <onnx/checker.h>
#include <onnx/shape_inference/implementation.h>

#include <algorithm>
#include <nlohmann/json.hpp>
#include <set>

#include "model/engine.h"
#include "model/model.h"
#include "tests/model/made_up_background.h"
#include "tests/model/onnx_evaluator.h"

namespace csipose {
namespace {

using testing::OnnxTensor;

onnx::ModelProto parsed(const Model& model) {
  onnx::ModelProto proto;
  EXPECT_TRUE(proto.ParseFromString(onnx_file(model)));
  return proto;
}

std::vector<float> window() {
  std::vector<float> x(kChannels * kTokens);
  for (std::size_t i = 0; i < x.size(); ++i) x[i] = 3 + 2 * std::sin(0.731f * static_cast<float>(i));
  return x;
}

/// Random weights, and an input scaling that would be missed.
std::shared_ptr<const Model> scaled_model(const NetworkConfig& config) {
  const auto file = SafetensorsFile::parse(random_weights(config, 5, HeadInit::random), "some.safetensors");
  const std::map<std::string, float> scaling = {
      {"norm.amp_mean", 2.5f}, {"norm.amp_std", 1.5f}, {"norm.ph_std", 0.75f}};
  std::vector<TensorView> tensors = file.tensors();
  for (TensorView& tensor : tensors)
    if (const auto it = scaling.find(tensor.name); it != scaling.end())
      tensor.bytes = ByteView(&it->second, sizeof(float));
  return Model::from(SafetensorsFile::parse(pack_safetensors(file.metadata(), tensors), "some.safetensors"));
}

/// The same against backgrounds.
std::shared_ptr<const Model> model_with_backgrounds(const NetworkConfig& config) {
  return testing::with_backgrounds(
      random_weights(config, 5, HeadInit::random),
      {testing::made_up_background("den", 1), testing::made_up_background("hall", 2)});
}

/// Outputs and the encoder's tokens, to `off`, of the graph and of the plain loops.
void expect_same(const Model& model, std::shared_ptr<const Model> owner, const std::vector<float>& x,
                 double off = 1e-5) {
  const auto engine = make_reference_engine(std::move(owner));
  const NetworkOutput expected = engine->run(x, LinkSet().set());
  const onnx::ModelProto proto = parsed(model);
  testing::OnnxEvaluator evaluator(proto.graph());
  const auto& values = evaluator.run("csi", {{1, kChannels, kSamples, kLinks}, {x.begin(), x.end()}});
  const OnnxTensor &poses = values.at("poses"), &scores = values.at("scores");
  const std::size_t queries = std::min(model.config().queries, model.config().token_grid().size());
  ASSERT_EQ(poses.shape, (std::vector<std::size_t>{1, queries, kJoints, 3}));
  ASSERT_EQ(scores.shape, (std::vector<std::size_t>{1, queries}));
  for (std::size_t i = 0; i < poses.data.size(); ++i)
    ASSERT_NEAR(poses.data[i], static_cast<double>(expected.poses[i]), off) << i;
  for (std::size_t q = 0; q < queries; ++q)
    EXPECT_NEAR(scores.data[q], 1 / (1 + std::exp(-static_cast<double>(expected.logits[q]))), 1e-6);
  const auto encoded = engine->stage("encoder");
  const OnnxTensor& named = values.at("encoder.norm");
  ASSERT_EQ(named.data.size(), encoded.size());
  for (std::size_t i = 0; i < encoded.size(); ++i)
    ASSERT_NEAR(named.data[i], static_cast<double>(encoded[i]), off) << i;
}

NetworkConfig micro(bool identity, std::size_t decoder_layers, std::size_t refine_layers,
                    bool query_conditioning = false) {
  NetworkConfig config = preset_config("micro");
  config.preset = "custom";
  config.identity_conditioning = identity;
  config.query_conditioning = query_conditioning;
  config.decoder_layers = decoder_layers;
  config.refine_layers = refine_layers;
  return config;
}

// The graph, by the description of its operators, against the network in plain loops.
TEST(OnnxGraph, ComputesTheNetwork) {
  for (const NetworkConfig& config : {micro(true, 2, 2), micro(false, 1, 1), micro(false, 1, 0),
                                      micro(true, 2, 1, /*query_conditioning=*/true)}) {
    const auto model = scaled_model(config);
    expect_same(*model, model, window());
  }
}

TEST(OnnxGraph, AsksNoMoreQueriesThanThereAreTokens) {
  NetworkConfig config = micro(true, 1, 1, /*query_conditioning=*/true);
  config.receiver_tokens = true;
  config.queries = kReceiverGrid.size() + 7;
  const auto model = scaled_model(config);
  expect_same(*model, model, window());
  onnx::checker::check_model(parsed(*model));
}

TEST(OnnxGraph, ChoosesTheBackground) {
  enum class Tokens { plain, of_receivers, with_neighbours };
  for (const Tokens kind : {Tokens::plain, Tokens::of_receivers, Tokens::with_neighbours}) {
    const bool told = kind != Tokens::plain;
    NetworkConfig config = micro(true, 1, 1);
    config.background_conditioning = told;
    config.receiver_tokens = kind == Tokens::of_receivers;
    config.receiver_conditioning = kind == Tokens::with_neighbours;
    const auto model = model_with_backgrounds(config);
    for (const std::uint64_t seed : {1, 2}) {
      const auto x = testing::window_before(testing::made_up_background("", seed), 7);
      expect_same(*model, model, x, 5e-5);  // departures are sums of many numbers, in float and in double
    }
    if (!told) continue;
    onnx::checker::check_model(parsed(*model));
    const auto without = scaled_model(config);
    expect_same(*without, without, window());
  }
}

// ONNX's own checker and shape inference, and what a reader of the file relies on.
TEST(OnnxGraph, IsSoundByTheRulesOfTheFormat) {
  onnx::checker::check_model(parsed(*model_with_backgrounds(micro(true, 1, 1))));
  const auto model = init_random(preset_config("tiny"), 1, HeadInit::zero);
  onnx::ModelProto proto = parsed(*model);
  onnx::checker::check_model(proto);
  EXPECT_EQ(proto.ir_version(), 8);
  ASSERT_EQ(proto.opset_import_size(), 1);
  EXPECT_EQ(proto.opset_import(0).version(), 17);
  ASSERT_EQ(proto.graph().input_size(), 1);
  EXPECT_EQ(proto.graph().input(0).name(), "csi");
  ASSERT_EQ(proto.graph().output_size(), 2);
  EXPECT_EQ(proto.graph().output(0).name(), "scores");
  EXPECT_EQ(proto.graph().output(1).name(), "poses");
  // What is said of the outputs must be what follows from the operators: strict inference compares.
  const onnx::ShapeInferenceOptions strict{/*check_type=*/true, /*strict_mode=*/1, /*data_prop=*/true};
  onnx::shape_inference::InferShapes(proto, onnx::OpSchemaRegistry::Instance(), strict);
  std::map<std::string, std::vector<std::int64_t>> shapes;
  for (const onnx::ValueInfoProto& info : proto.graph().value_info())
    for (const auto& size : info.type().tensor_type().shape().dim())
      shapes[info.name()].push_back(size.dim_value());
  EXPECT_EQ(shapes["encoder.norm"], (std::vector<std::int64_t>{1, 180, 128}));
  EXPECT_EQ(shapes["proposals.token"], (std::vector<std::int64_t>{12}));
  EXPECT_EQ(shapes["refine_decoder.layers.0.norm3"], (std::vector<std::int64_t>{12, 14, 128}));
  std::set<std::string> names;
  for (const onnx::TensorProto& tensor : proto.graph().initializer())
    EXPECT_TRUE(names.insert(tensor.name()).second) << tensor.name();
}

TEST(OnnxGraph, SaysWhereItComesFrom) {
  const auto model = init_random(preset_config("micro"), 1, HeadInit::zero);
  const onnx::ModelProto proto = parsed(*model);
  std::map<std::string, std::string> metadata;
  for (const auto& entry : proto.metadata_props()) metadata[entry.key()] = entry.value();
  EXPECT_EQ(metadata["weights_sha256"], model->digest());
  EXPECT_EQ(metadata["stage"], "untrained");
  EXPECT_EQ(metadata["phase"], "joint");
  EXPECT_EQ(config_from_json(metadata["preset"], metadata["config"]), model->config());
  EXPECT_EQ(nlohmann::json::parse(metadata["joint_order"]).at(1), "head");
  EXPECT_EQ(onnx_file(*model), onnx_file(*model)) << "the same weights make the same file";
}

}  // namespace
}  // namespace csipose
