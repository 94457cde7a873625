// csipose-train calibrate and eval as people call them, on a made-up folder of windows.
#include <nlohmann/json.hpp>

#include "model/cpu.h"
#include "model/engine.h"
#include "model/model.h"
#include "model/onednn_engine.h"
#include "proto/npy.h"
#include "proto/result.h"
#include "tests/daemon/program.h"
#include "tests/daemon/scratch_folder.h"
#include "tests/file_bytes.h"

namespace csipose::train {
namespace {

namespace fs = std::filesystem;
using csipose::testing::file_bytes;
constexpr std::size_t kWindows = 12;

/// Random weights that are sure of everybody, and windows in every other one of which its best guess is there.
class Commands : public ::testing::Test {
 protected:
  void SetUp() override {
    NetworkConfig config = preset_config("micro");
    config.joint_sigma = true;
    const auto file = SafetensorsFile::parse(random_weights(config, 3, HeadInit::random), "draft");
    std::vector<TensorView> tensors = file.tensors();
    const float bias = 2;
    for (TensorView& view : tensors)
      if (view.name == "cls_branches.0.bias") view.bytes = ByteView(&bias, sizeof(bias));
    auto metadata = file.metadata();
    metadata["of_others"] = "kept";
    write_file_atomically(model_, pack_safetensors(metadata, tensors));
    write_windows();
  }

  void write_windows() const {
    const auto model = Model::load(model_);
    const auto engine = make_reference_engine(model);
    std::mt19937 random(1);
    std::normal_distribution<float> numbers;
    std::vector<float> windows(kWindows * kChannels * kTokens), labels(kWindows * kJoints * 3, kUnknown);
    for (float& number : windows) number = numbers(random);
    for (std::size_t i = 0; i < kWindows; i += 2) {
      const auto x = std::span(windows).subspan(i * kChannels * kTokens, kChannels * kTokens);
      const NetworkOutput output = engine->run(x, LinkSet().set());
      const auto best = std::max_element(output.logits.begin(), output.logits.end()) - output.logits.begin();
      for (std::size_t k = 0; k < kPoseWidth; ++k)
        labels[i * kJoints * 3 + k] = output.poses[static_cast<std::size_t>(best) * kJoints * 3 + k] +
                                      0.03f * static_cast<float>(k % 7);
    }
    fs::create_directories(set_);
    write_npy<float>(fs::path(set_) / "windows.npy", {kWindows, kChannels, kSamples, kLinks}, windows);
    write_npy<std::uint32_t>(fs::path(set_) / "clip.npy", {kWindows},
                             std::vector<std::uint32_t>(kWindows, 0));
    write_npy<float>(fs::path(set_) / "labels.npy", {kWindows, 1, kJoints, 3}, labels);
  }

  /// Exit status; what it complained of is then in complaint().
  int run(const std::string& command, std::vector<std::string> arguments) const {
    arguments.insert(arguments.begin(), command);
    arguments.insert(arguments.end(), {"--precision", "f32", "--threads", "1"});
    fs::remove(log_);
    return testing::Program("csipose-train", arguments, log_).wait();
  }
  std::string complaint() const { return file_bytes(log_); }

  testing::ScratchFolder scratch_;
  std::string model_ = scratch_ / "w.safetensors", set_ = scratch_ / "set", out_ = scratch_ / "out",
              log_ = scratch_ / "log";
};

TEST_F(Commands, CalibrateWritesWhatEvalThenMeasures) {
  const std::string before = file_bytes(model_);
  ASSERT_EQ(run("calibrate", {"--model", model_, "--data", set_, "--out", out_}), 0) << complaint();
  EXPECT_EQ(file_bytes(model_), before);
  const auto file = SafetensorsFile::read(out_);
  const auto account = nlohmann::json::parse(Model::from(file)->provenance().confidences);
  EXPECT_EQ(account["data"], "set");
  EXPECT_EQ(account["windows"], kWindows);
  EXPECT_EQ(account["matched"], kWindows / 2);
  EXPECT_EQ(file.metadata().at("of_others"), "kept");

  ASSERT_EQ(run("eval", {"--model", out_, "--data", set_, "--train", set_, "--out", scratch_ / "report"}), 0)
      << complaint();
  const auto report = nlohmann::json::parse(file_bytes(scratch_ / "report/metrics.json"));
  const auto& calibration = report["results"]["model"]["calibration"];
  EXPECT_EQ(calibration["joints"]["stated"], kJoints * kWindows / 2);
  EXPECT_NEAR(calibration["joints"]["ece"].get<double>(), account["ece_joints"][1].get<double>(), 1e-9);
  EXPECT_NEAR(calibration["score"]["ece"].get<double>(), account["ece_score"][1].get<double>(), 1e-9);
  EXPECT_FALSE(report["results"]["mean_pose"].contains("calibration"));
  for (const char* picture : {"skeletons.png", "joints.png", "counts.png"})
    EXPECT_EQ(file_bytes(scratch_ / "report/" + picture).substr(1, 3), "PNG") << picture;
}

TEST_F(Commands, CalibrateInPlaceAgainChangesNothing) {
  ASSERT_EQ(run("calibrate", {"--model", model_, "--data", set_}), 0) << complaint();
  const auto once = Model::load(model_)->calibration();
  ASSERT_EQ(run("calibrate", {"--model", model_, "--data", set_}), 0) << complaint();
  const auto twice = Model::load(model_)->calibration();
  EXPECT_EQ(once.joint_scale, twice.joint_scale);
  EXPECT_EQ(once.confidence->corrected, twice.confidence->corrected);
}

TEST_F(Commands, GateMeasuresErrorsWhereThePrecisionsWereMeasured) {
  const auto gate = [&] {
    fs::remove(log_);
    return testing::Program("csipose-train", {"gate", "--model", model_, "--data", set_, "--threads", "1"},
                            log_)
        .wait();
  };
  EXPECT_EQ(gate(), static_cast<int>(ExitStatus::bad_data));
  EXPECT_NE(complaint().find("csipose model calibrate"), std::string::npos) << complaint();
  write_file_atomically(model_, with_gate(SafetensorsFile::read(model_), {{"bf16", {0.5, 1, 3}}}));
  ASSERT_EQ(gate(), 0) << complaint();
  const auto model = Model::load(model_);
  const GateFigures& figures = model->gate().at("bf16");
  EXPECT_EQ(figures.mean_joint_shift_m, 0.5);
  if (why_not(Precision::bf16, cpu_features(), *model)) {
    EXPECT_FALSE(figures.labelled);
    return;
  }
  ASSERT_TRUE(figures.labelled);
  EXPECT_EQ(figures.labelled->windows, kWindows);
  EXPECT_GT(figures.labelled->f32_mpjpe_m, 0.01);  // labels are off by 0 to 18 cm along each axis
  EXPECT_LT(figures.labelled->f32_mpjpe_m, 0.3);
  EXPECT_NEAR(figures.labelled->mpjpe_m, figures.labelled->f32_mpjpe_m, 0.1);
}

TEST_F(Commands, WhatCannotBeCalibratedIsLeftAlone) {
  const std::string before = file_bytes(model_);
  const auto status = [](ExitStatus expected) { return static_cast<int>(expected); };
  EXPECT_EQ(run("calibrate", {"--model", model_, "--data", scratch_ / "nowhere"}),
            status(ExitStatus::no_input));
  EXPECT_EQ(run("calibrate", {"--model", set_ + "/windows.npy", "--data", set_}),
            status(ExitStatus::bad_data));
  EXPECT_EQ(run("calibrate", {"--model", model_, "--data", set_, "--out", scratch_ / "no/where"}),
            status(ExitStatus::cannot_create));
  fs::remove(fs::path(set_) / "labels.npy");
  EXPECT_EQ(run("calibrate", {"--model", model_, "--data", set_}), status(ExitStatus::bad_data));
  EXPECT_NE(complaint().find("labels.npy"), std::string::npos) << complaint();
  EXPECT_EQ(file_bytes(model_), before);
}

}  // namespace
}  // namespace csipose::train
