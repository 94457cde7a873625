#include "model/model.h"

#include <gtest/gtest.h>

#include <cmath>
#include <cstring>
#include <functional>

#include "model/engine.h"
#include "proto/result.h"

namespace csipose {
namespace {

/// The smallest network that has every part.
NetworkConfig least_config() {
  NetworkConfig config;
  config.preset = "custom";
  config.dim = config.decoder_dim = 4;
  config.depth = config.heads = config.decoder_heads = config.decoder_layers = config.refine_layers = 1;
  config.ffn = config.kpt_hidden = 4;
  config.queries = 2;
  config.joint_sigma = true;
  return config;
}

/// A sealed file that a test may change before it is read.
struct Draft {
  explicit Draft(const NetworkConfig& config = least_config())
      : file(SafetensorsFile::parse(random_weights(config, 1, HeadInit::random), "draft")),
        metadata(file.metadata()),
        tensors(file.tensors()) {}
  TensorView& tensor(const std::string& name) {
    for (TensorView& view : tensors)
      if (view.name == name) return view;
    ADD_FAILURE() << name;
    return tensors.front();
  }
  void add(const std::string& name, std::vector<std::size_t> shape, const std::vector<float>& numbers) {
    kept.push_back(std::make_unique<std::vector<float>>(numbers));
    tensors.push_back(
        {name, DType::f32, std::move(shape), ByteView(kept.back()->data(), 4 * numbers.size())});
  }
  void set(const std::string& name, const std::vector<float>& numbers) {
    kept.push_back(std::make_unique<std::vector<float>>(numbers));
    ByteView& bytes = tensor(name).bytes;
    ASSERT_EQ(bytes.size(), 4 * numbers.size());
    bytes = ByteView(kept.back()->data(), bytes.size());
  }
  std::vector<float> numbers(const std::string& name) { return to_floats(tensor(name)); }
  std::shared_ptr<const Model> load() const {
    return Model::from(SafetensorsFile::parse(pack_safetensors(metadata, tensors), "some.safetensors"));
  }
  SafetensorsFile file;
  std::map<std::string, std::string> metadata;
  std::vector<TensorView> tensors;
  std::vector<std::unique_ptr<std::vector<float>>> kept;
};

std::string refusal(const std::function<void(Draft&)>& damage) {
  Draft draft;
  damage(draft);
  try {
    draft.load();
  } catch (const SetupError& error) {
    EXPECT_EQ(error.status, ExitStatus::bad_data);
    EXPECT_NE(std::string(error.what()).find("some.safetensors"), std::string::npos) << error.what();
    return error.what();
  }
  return "";
}

std::vector<float> input(float phase) {
  std::vector<float> x(kChannels * kTokens);
  for (std::size_t i = 0; i < x.size(); ++i) x[i] = std::sin(phase + 0.37f * static_cast<float>(i));
  return x;
}

TEST(Model, RandomWeightsAreWholeAndMarkedUntrained) {
  const auto model = init_random(preset_config("micro"), 7, HeadInit::zero);
  EXPECT_TRUE(model->untrained());
  EXPECT_EQ(model->provenance().seed, 7u);
  EXPECT_EQ(model->config(), preset_config("micro"));
  EXPECT_EQ(model->digest().size(), 64u);
  EXPECT_EQ(model->demand().phase, "joint");
  EXPECT_EQ(model->model_to_room(), kIdentityTransform);
}

TEST(Model, SameSeedSameBytes) {
  const NetworkConfig config = preset_config("micro");
  EXPECT_EQ(random_weights(config, 3, HeadInit::zero), random_weights(config, 3, HeadInit::zero));
  EXPECT_NE(random_weights(config, 3, HeadInit::zero), random_weights(config, 4, HeadInit::zero));
}

TEST(Model, InitHasTheSpreadItIsNamedFor) {
  const auto model = init_random(preset_config("micro"), 1, HeadInit::zero);
  const auto rms = [&](const char* name) {
    double sum = 0;
    for (const float v : model->tensors()[name].data) sum += static_cast<double>(v) * static_cast<double>(v);
    return std::sqrt(sum / static_cast<double>(model->tensors()[name].data.size()));
  };
  EXPECT_NEAR(rms("encoder.blocks.0.mlp.fc1.weight"), 0.02, 0.001);
  EXPECT_NEAR(rms("query_embedding.weight"), 1, 0.1);
  // Xavier uniform: variance 2 / (fan in + fan out).
  EXPECT_NEAR(rms("decoder.layers.0.linear1.weight"), std::sqrt(2. / (64 + 256)), 0.002);
  EXPECT_EQ(rms("kpt_branches.0.6.weight"), 0);
  EXPECT_EQ(rms("refine_kpt_branches.0.4.weight"), 0);
  EXPECT_EQ(rms("refine_identity.weight"), 0);
  EXPECT_FLOAT_EQ(model->tensors()["cls_branches.0.bias"].data[0], -std::log(99.f));
  EXPECT_EQ(rms("encoder.norm.weight"), 1);
}

TEST(Model, RefusesMissingMisshapenAndUnknownTensors) {
  EXPECT_EQ(refusal([](Draft&) {}), "");
  EXPECT_NE(refusal([](Draft& d) { d.tensors.pop_back(); }).find("is missing"), std::string::npos);
  EXPECT_NE(refusal([](Draft& d) {
              d.tensor("proj.weight").shape = {2, 8};
            }).find("'proj.weight' has shape [2, 8]"),
            std::string::npos);
  EXPECT_NE(refusal([](Draft& d) { d.tensor("proj.weight").dtype = DType::i32; }).find("I32"),
            std::string::npos);
  EXPECT_NE(refusal([](Draft& d) { d.add("head.weight", {1}, {1}); }).find("'head.weight' is not part"),
            std::string::npos);
  EXPECT_EQ(refusal([](Draft& d) { d.add("predictor.mask_token", {1}, {1}); }), "");
  EXPECT_EQ(refusal([](Draft& d) { d.add("target_encoder.norm.weight", {1}, {1}); }), "");
}

TEST(Model, RefusesNumbersThatAreNotFinite) {
  for (const float bad : {NAN, HUGE_VALF, -HUGE_VALF})
    EXPECT_NE(refusal([&](Draft& d) {
                auto bias = d.numbers("proj.bias");
                bias[2] = bad;
                d.set("proj.bias", bias);
              }).find("'proj.bias' holds"),
              std::string::npos);
  EXPECT_NE(refusal([](Draft& d) { d.set("norm.amp_std", {0}); }).find("norm.amp_std"), std::string::npos);
}

TEST(Model, RefusesMetadataThatIsMissingOrMakesNoSense) {
  const Draft whole;
  for (const auto& [key, value] : whole.metadata) {
    if (key == "content_sha256") continue;
    EXPECT_NE(refusal([&key = key](Draft& d) { d.metadata.erase(key); }).find("'" + key + "'"),
              std::string::npos)
        << key;
  }
  const std::pair<const char*, const char*> bad[] = {{"format_version", "2"},
                                                     {"stage", "done"},
                                                     {"step", "-1"},
                                                     {"step", "1.5"},
                                                     {"seed", "x"},
                                                     {"metrics", "[]"},
                                                     {"calibration", "1"},
                                                     {"joint_order", "[\"neck\"]"},
                                                     {"model_to_room", "[[1,0,0,0],[0,1,0,0]]"},
                                                     {"model_to_room", "[[1,0,0,0],[0,1,0,0],[0,0,2,0]]"},
                                                     {"model_to_room", "[[1,0,0,0],[0,1,0,0],[0,1,0,0]]"},
                                                     {"model_to_room", "[[1,0,0,0],[0,1,0,0],[0,0,1,\"a\"]]"},
                                                     {"rate_hz", "0"},
                                                     {"rate_hz", "1e99"},
                                                     {"phase", "raw"},
                                                     {"amplitude", "db"},
                                                     {"min_links", "10"},
                                                     {"min_links", "0"},
                                                     {"config", "{}"},
                                                     {"preset", "paper"},
                                                     {"gate", "[]"},
                                                     {"gate", "{\"f64\":{}}"},
                                                     {"gate", "{\"int8\":{\"windows\":1}}"}};
  for (const auto& [key, value] : bad)
    EXPECT_NE(refusal([&key = key, &value = value](Draft& d) { d.metadata[key] = value; }).find(key),
              std::string::npos)
        << key << " " << value;
}

TEST(Model, RefusesAFileWithoutItsDigest) {
  std::vector<std::uint8_t> bytes = random_weights(least_config(), 1, HeadInit::zero);
  std::string text(bytes.begin(), bytes.end());
  const auto place = text.find("content_sha256");
  ASSERT_NE(place, std::string::npos);
  bytes[place] = 'k';
  try {
    Model::from(SafetensorsFile::parse(bytes, "f"));
    FAIL();
  } catch (const SetupError& error) {
    EXPECT_NE(std::string(error.what()).find("content_sha256"), std::string::npos);
  }
}

// A flipped bit is refused, or the model is the same but for its digest.
TEST(Model, FlippedHeaderBitsAreRefusedOrMeanTheSame) {
  const std::vector<std::uint8_t> good = random_weights(least_config(), 1, HeadInit::zero);
  const std::size_t header = 8 + static_cast<std::size_t>(load_le<std::uint64_t>(good.data()));
  const auto meant = Model::from(SafetensorsFile::parse(good, "good"));
  for (std::size_t bit = 0; bit < 8 * header;
       bit += 61) {  // safetensors_test flips all; 61 meets every place in a byte
    std::vector<std::uint8_t> bad = good;
    bad[bit / 8] ^= static_cast<std::uint8_t>(1 << bit % 8);
    try {
      const auto model = Model::from(SafetensorsFile::parse(bad, "bad"));
      EXPECT_EQ(model->config(), meant->config());
      EXPECT_EQ(model->provenance().seed, meant->provenance().seed);
      EXPECT_EQ(model->tensors()["proj.weight"].data, meant->tensors()["proj.weight"].data);
    } catch (const SetupError&) {
    }
  }
}

TEST(Model, CalibrationIsReadAndChecked) {
  std::vector<float> knots(2 * kConfidenceKnots);
  for (std::size_t i = 0; i < kConfidenceKnots; ++i)
    knots[i] = knots[kConfidenceKnots + i] = static_cast<float>(i) / (kConfidenceKnots - 1);
  Draft draft;
  draft.add("calib.score", {2}, {2, -1});
  draft.add("calib.joint_scale", {14}, std::vector<float>(14, 1.5f));
  draft.add("calib.conf", {2, kConfidenceKnots}, knots);
  draft.add("calib.int8.proj", {}, {3.5f});
  draft.add("calib.int8.decoder.layers.0.self_attn.in_proj", {1}, {2});
  const auto model = draft.load();
  EXPECT_EQ(model->calibration().score->b, -1);
  EXPECT_EQ(model->calibration().joint_scale->at(13), 1.5f);
  EXPECT_EQ(model->calibration().confidence->corrected.back(), 1);
  EXPECT_EQ(model->calibration().int8_input_max.at("proj"), 3.5f);
  EXPECT_EQ(model->calibration().int8_input_max.size(), 2u);

  EXPECT_NE(refusal([](Draft& d) {
              d.add("calib.score", {2}, {-1, 0});
            }).find("calib.score"),
            std::string::npos);
  EXPECT_NE(refusal([](Draft& d) { d.add("calib.int8.nothing", {}, {1}); }).find("no layer"),
            std::string::npos);
  EXPECT_NE(refusal([](Draft& d) { d.add("calib.int8.proj", {}, {0}); }).find("above zero"),
            std::string::npos);
  EXPECT_NE(refusal([&](Draft& d) {
              std::swap(knots[3], knots[4]);
              d.add("calib.conf", {2, kConfidenceKnots}, knots);
            }).find("calib.conf"),
            std::string::npos);
}

TEST(Model, Int8CalibrationIsWrittenAndReplaced) {
  const Draft draft;
  const auto once = with_int8_calibration(draft.file, {{"proj", 1.f}, {"decoder.layers.0.linear1", 2.f}}, {});
  const GateFigures figures = {0.001, 0.004, 100};
  const auto twice =
      with_int8_calibration(SafetensorsFile::parse(once, "once"), {{"proj", 3.f}}, {{"int8", figures}});
  const auto model = Model::from(SafetensorsFile::parse(twice, "twice"));
  EXPECT_EQ(model->calibration().int8_input_max, (std::map<std::string, float>{{"proj", 3.f}}));
  EXPECT_EQ(model->gate().at("int8").max_joint_shift_m, 0.004);
  EXPECT_EQ(model->gate().at("int8").windows, 100u);
}

TEST(Model, GateIsWrittenAndReadWithWhatLabelsSaid) {
  const Draft draft;
  GateFigures figures = {0.021, 0.4, 100};
  figures.labelled = {0.3731, 0.3747, 7684};
  const auto bytes = with_gate(draft.file, {{"bf16", {0.001, 0.004, 100}}, {"int8", figures}});
  const auto model = Model::from(SafetensorsFile::parse(bytes, "gated"));
  EXPECT_FALSE(model->gate().at("bf16").labelled);
  const auto& read = model->gate().at("int8").labelled;
  ASSERT_TRUE(read);
  EXPECT_EQ(read->mpjpe_m, 0.3731);
  EXPECT_EQ(read->f32_mpjpe_m, 0.3747);
  EXPECT_EQ(read->windows, 7684u);
  EXPECT_NE(refusal([](Draft& d) {
              d.metadata["gate"] =
                  R"({"int8":{"mean_joint_shift_m":0,"max_joint_shift_m":0,"windows":1,"labelled":{}}})";
            }).find("mpjpe_m"),
            std::string::npos);
  EXPECT_NE(refusal([](Draft& d) {
              d.metadata["gate"] =
                  R"({"int8":{"mean_joint_shift_m":0,"max_joint_shift_m":0,"windows":1,"other":1}})";
            }).find("'other'"),
            std::string::npos);
}

TEST(Model, ConfidencesAreWrittenReplacedAndTakenOut) {
  Draft draft;
  std::string names;
  for (std::size_t i = 0; i < kJoints; ++i)
    names += (i == 0 ? "[\"" : ",\"") + std::string(kJointNames[kJoints - 1 - i]) + "\"";
  draft.metadata["joint_order"] = names + "]";
  draft.metadata["of_others"] = "kept";
  draft.add("calib.int8.proj", {}, {7});
  const auto before =
      SafetensorsFile::parse(pack_safetensors(draft.metadata, draft.tensors), "draft, joints reversed");
  Calibration calibration;
  calibration.score = PlattScaling{2, -1};
  calibration.joint_scale.emplace();
  calibration.confidence.emplace();
  for (std::size_t j = 0; j < kJoints; ++j) (*calibration.joint_scale)[j] = 1 + static_cast<float>(j);
  for (std::size_t i = 0; i < kConfidenceKnots; ++i) {
    calibration.confidence->raw[i] = static_cast<float>(i) / 20;
    calibration.confidence->corrected[i] = static_cast<float>(i) / 40;
  }
  const auto with = SafetensorsFile::parse(with_confidences(before, calibration, "{\"windows\":3}"), "with");
  EXPECT_EQ(to_floats(*with.find("calib.joint_scale")).front(), 14) << "in the file's order";
  const auto model = Model::from(with);
  EXPECT_EQ(model->calibration().score->a, 2);
  EXPECT_EQ(model->calibration().score->b, -1);
  EXPECT_EQ(*model->calibration().joint_scale, *calibration.joint_scale);
  EXPECT_EQ(model->calibration().confidence->raw, calibration.confidence->raw);
  EXPECT_EQ(model->calibration().confidence->corrected, calibration.confidence->corrected);
  EXPECT_EQ(model->calibration().int8_input_max.at("proj"), 7);
  EXPECT_EQ(model->provenance().confidences, "{\"windows\":3}");

  // Everything else is what it was, and goes back to what it was.
  auto metadata = with.metadata();
  metadata.erase("calibration");
  metadata["content_sha256"] = before.metadata().at("content_sha256");
  EXPECT_EQ(metadata, before.metadata());
  EXPECT_EQ(with.tensors().size(), before.tensors().size() + 3);
  for (const TensorView& view : before.tensors())
    EXPECT_EQ(to_floats(*with.find(view.name)), to_floats(view)) << view.name;
  const auto without = SafetensorsFile::parse(with_confidences(with, {}, "{}"), "without");
  EXPECT_EQ(without.tensors().size(), before.tensors().size());
  EXPECT_EQ(without.metadata().at("of_others"), "kept");
}

// The same network written with its joints in another order says the same of each joint.
TEST(Model, JointsOfAnotherOrderArePutInOurs) {
  Draft draft;
  const auto ours = draft.load();
  std::vector<std::size_t> file_order(kJoints);  // place in the file -> our joint
  for (std::size_t i = 0; i < kJoints; ++i) file_order[i] = (5 * i + 3) % kJoints;
  std::string names;
  for (const std::size_t joint : file_order)
    names += (names.empty() ? "[\"" : ",\"") + std::string(kJointNames[joint]) + "\"";
  draft.metadata["joint_order"] = names + "]";
  for (const std::string name :
       {"kpt_branches.0.6.weight", "kpt_branches.0.6.bias", "kpt_branches.1.6.weight",
        "kpt_branches.1.6.bias", "refine_query_embedding.weight"}) {
    const std::vector<float> in_our_order = draft.numbers(name);
    std::vector<float> in_file_order;
    const std::size_t width = in_our_order.size() / kJoints;
    for (const std::size_t joint : file_order)
      for (std::size_t k = 0; k < width; ++k) in_file_order.push_back(in_our_order[joint * width + k]);
    draft.set(name, in_file_order);
  }
  const auto theirs = draft.load();
  const auto x = input(0);
  const auto a = make_reference_engine(ours), b = make_reference_engine(theirs);
  const NetworkOutput from_ours = a->run(x, LinkSet().set()), from_theirs = b->run(x, LinkSet().set());
  ASSERT_EQ(from_ours.poses.size(), from_theirs.poses.size());
  for (std::size_t i = 0; i < from_ours.poses.size(); ++i)
    EXPECT_NEAR(from_ours.poses[i], from_theirs.poses[i], 1e-6);
}

TEST(Model, DuplicateJointNameIsRefused) {
  EXPECT_NE(refusal([](Draft& d) {
              std::string& order = d.metadata["joint_order"];
              order.replace(order.find("head"), 4, "neck");
            }).find("'neck'"),
            std::string::npos);
}

TEST(Model, HalfPrecisionFilesAreRead) {
  Draft draft;
  std::vector<std::uint8_t> halves;
  for (const float v : draft.numbers("proj.weight")) {
    std::uint32_t bits;
    std::memcpy(&bits, &v, 4);
    halves.push_back(static_cast<std::uint8_t>(bits >> 16));
    halves.push_back(static_cast<std::uint8_t>(bits >> 24));
  }
  const auto exact = draft.load();
  TensorView& view = draft.tensor("proj.weight");
  view.dtype = DType::bf16;
  view.bytes = halves;
  const auto model = draft.load();
  for (std::size_t i = 0; i < 16; ++i)
    EXPECT_NEAR(model->tensors()["proj.weight"].data[i], exact->tensors()["proj.weight"].data[i], 0.01);
}

}  // namespace
}  // namespace csipose
