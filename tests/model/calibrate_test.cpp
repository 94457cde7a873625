// Calibration writes what the engine's choice of precision reads.
#include "model/calibrate.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>

#include "model/cpu.h"
#include "model/onednn_engine.h"
#include "model/reference.h"
#include "proto/result.h"

namespace csipose {
namespace {

SafetensorsFile weights_file(HeadInit heads = HeadInit::random) {
  return SafetensorsFile::parse(random_weights(preset_config("micro"), 3, heads), "made by the test");
}
std::vector<WindowTensor> windows(std::size_t count) { return noise_windows({}, count, 5); }

TEST(Calibration, FirstLayersScaleIsTheLargestNormalisedNumber) {
  const auto model = Model::from(weights_file());
  const std::vector<WindowTensor> some = windows(2);
  const auto calibration = calibrate_int8(model, some, 1);
  float most = 0;
  for (const WindowTensor& window : some) {
    const NetworkConfig& c = model->config();
    const auto visible = c.tokens_there(LinkSet().set());
    const auto encoded = reference::encode(model->tensors(), "encoder.", {c.dim, 0, c.heads},
                                           reference::tokens_of(window), visible);
    const auto normed =
        reference::layer_norm(encoded.embed, model->tensors(), "encoder.blocks.0.norm1", 1e-6);
    for (const float value : normed.data) most = std::max(most, std::abs(value));
  }
  EXPECT_NEAR(calibration.input_max.at("encoder.blocks.0.attn.qkv"), most, 1e-5);
  EXPECT_EQ(calibration.input_max.size(), 4 * model->config().depth);
}

TEST(Calibration, MoreWindowsNeverNarrowTheRange) {
  const auto model = Model::from(weights_file());
  const auto few = calibrate_int8(model, windows(1), 1), more = calibrate_int8(model, windows(4), 1);
  for (const auto& [layer, most] : few.input_max) EXPECT_LE(most, more.input_max.at(layer)) << layer;
}

TEST(Calibration, FileCarriesScalesAndFigures) {
  const auto file =
      SafetensorsFile::parse(calibrate_file(weights_file(), windows(2), 1), "calibrated by the test");
  const auto model = Model::from(file);
  EXPECT_EQ(model->calibration().int8_input_max.size(), 4 * model->config().depth);
  for (const Precision precision : {Precision::bf16, Precision::int8}) {
    const std::string name(name_of(precision));
    const bool possible = !why_not(precision, cpu_features(), *model);
    ASSERT_EQ(model->gate().count(name), possible ? 1u : 0u) << name;
    if (!possible) continue;
    EXPECT_EQ(model->gate().at(name).windows, 2u);
    EXPECT_GT(model->gate().at(name).mean_joint_shift_m, 0) << "a lower precision moves something";
  }
  EXPECT_EQ(model->tensors()["proj.weight"].data, Model::from(weights_file())->tensors()["proj.weight"].data);
}

/// The gate's figure decides the automatic choice, in both directions.
TEST(Calibration, GateDecidesTheChoice) {
  if (!cpu_features().avx512_vnni) GTEST_SKIP() << "no VNNI on " << to_string(cpu_features());
  const SafetensorsFile file = weights_file();
  const auto input_max = calibrate_int8(Model::from(file), windows(1), 1).input_max;
  const GateFigures far = {2 * kMostJointShift_m, 0.1, 1};
  const auto model = Model::from(SafetensorsFile::parse(
      with_int8_calibration(file, input_max, {{"bf16", far}, {"int8", far}}), "beyond the gate"));
  OneDnnOptions options;
  options.threads = 1;
  EXPECT_EQ(make_onednn_engine(model, options)->precision(), Precision::f32);
  options.precision = Precision::int8;
  const auto asked = make_onednn_engine(model, options);
  EXPECT_EQ(asked->precision(), Precision::int8);
  EXPECT_NE(asked->notes().find("int8 as asked, although"), std::string::npos) << asked->notes();
}

// Where people were labelled it is the error that counts, one per cent of it, and not how far they were moved.
TEST(Calibration, LabelsDecideWhereThereAreSome) {
  GateFigures figures = {2 * kMostJointShift_m, 0.1, 1};
  EXPECT_FALSE(passes_gate(figures));
  figures.labelled = {0.1009, 0.1, 1};
  EXPECT_TRUE(passes_gate(figures));
  figures = {0, 0, 1, GateFigures::Labelled{0.1011, 0.1, 1}};
  EXPECT_FALSE(passes_gate(figures));
  EXPECT_NE(words_for(figures).find("101.1 mm"), std::string::npos) << words_for(figures);
}

TEST(Calibration, AMissingScaleIsRefusedByName) {
  if (!cpu_features().avx512_vnni) GTEST_SKIP() << "no VNNI on " << to_string(cpu_features());
  const SafetensorsFile file = weights_file();
  auto input_max = calibrate_int8(Model::from(file), windows(1), 1).input_max;
  input_max.erase("encoder.blocks.1.mlp.fc2");
  const auto model =
      Model::from(SafetensorsFile::parse(with_int8_calibration(file, input_max, {}), "made by the test"));
  const auto reason = why_not(Precision::int8, cpu_features(), *model);
  ASSERT_TRUE(reason);
  EXPECT_NE(reason->find("lacks encoder.blocks.1.mlp.fc2"), std::string::npos) << *reason;
}

}  // namespace
}  // namespace csipose
