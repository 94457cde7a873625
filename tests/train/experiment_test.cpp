// Rows of the published tables at micro size, on folders of made-up windows.
#include "train/experiment.h"

#include "model/engine.h"
#include "model/model.h"
#include "proto/npy.h"
#include "proto/result.h"
#include "tests/daemon/scratch_folder.h"
#include "tests/train/made_up_set.h"
#include "train/loop.h"

namespace csipose::train {
namespace {

namespace fs = std::filesystem;
using csipose::testing::MadeUpSet;

class Experiments : public ::testing::Test {
 protected:
  Experiments() {
    settings_.run.out = scratch_ / "runs";
    settings_.run.threads = 1;
    settings_.run.precision = "f32";
    settings_.network.preset = "micro";
    settings_.pretrain.batch = settings_.finetune.batch = 16;
    settings_.pretrain.epochs = settings_.finetune.epochs = 1;
    settings_.finetune.sigma_epochs = 0;
    settings_.finetune.lose_receiver = settings_.finetune.lose_two_receivers = settings_.finetune.lose_links =
        0;
    settings_.data.hold_out = 0.2;
    prepare_machine(settings_);
  }

  std::string folder(const std::string& name, std::size_t windows, std::uint64_t seed) const {
    const MadeUpSet set(windows, 1, seed);
    std::vector<float> x(windows * kChannels * kTokens), labels;
    std::vector<std::uint32_t> clip;
    for (std::size_t i = 0; i < windows; ++i) {
      set.read(i, std::span(x).subspan(i * kChannels * kTokens, kChannels * kTokens));
      for (const Point3& joint : set.people(i)[0]) labels.insert(labels.end(), {joint.x, joint.y, joint.z});
      clip.push_back(static_cast<std::uint32_t>(set.clip(i)));
    }
    const fs::path path = scratch_ / name;
    fs::create_directories(path);
    write_npy<float>(path / "windows.npy", {windows, kChannels, kSamples, kLinks}, x);
    write_npy<std::uint32_t>(path / "clip.npy", {windows}, clip);
    write_npy<float>(path / "labels.npy", {windows, 1, kJoints, 3}, labels);
    return path.string();
  }

  std::vector<ExperimentResult> run(const std::string& id, const std::vector<std::uint64_t>& seeds) const {
    return run_experiment(experiment_named(id), settings_, data_, seeds);
  }

  testing::ScratchFolder scratch_;
  RunSettings settings_;
  ExperimentData data_{{folder("here", 60, 1)}, {}, {}, {folder("test", 20, 2)}};
};

TEST_F(Experiments, PretrainFineTuneAndJudgeEachSeedOnce) {
  const auto results = run("T7a", {3, 4});
  ASSERT_EQ(results.size(), 2u);
  EXPECT_NE(results[0].error_mm, results[1].error_mm);
  for (const ExperimentResult& result : results) {
    EXPECT_GT(result.error_mm, 10);
    EXPECT_LT(result.error_mm, 5000);
  }
  const fs::path done = fs::path(settings_.run.out) / "T7a-seed3/pretrain/pretrained.safetensors";
  ASSERT_TRUE(fs::exists(done));
  // Made once more it reads what it wrote, and says the same.
  const auto before =
      fs::last_write_time(fs::path(settings_.run.out) / "T7a-seed3/finetune/best.safetensors");
  const auto again = run("T7a", {3});
  EXPECT_EQ(again[0].error_mm, results[0].error_mm);
  EXPECT_EQ(fs::last_write_time(fs::path(settings_.run.out) / "T7a-seed3/finetune/best.safetensors"), before);
}

TEST_F(Experiments, FlatTokensAreLearntAndJudgedButNoEngineTakesThem) {
  const auto results = run("T8", {0});
  EXPECT_GT(results[0].error_mm, 10);
  EXPECT_LT(results[0].error_mm, 5000);
  const auto model = Model::load(fs::path(settings_.run.out) / "T8-seed0/finetune/best.safetensors");
  EXPECT_TRUE(model->config().flat_tokens);
  EXPECT_THROW(make_reference_engine(model), SetupError);
  EXPECT_THROW(make_onednn_engine(model, {}), SetupError);
}

TEST_F(Experiments, FlatTokensNeedWholeWindows) {
  settings_.finetune.samples = 4;
  EXPECT_THROW(run("T8", {0}), SetupError);
  settings_.finetune.samples = 20;
  settings_.finetune.lose_links = 0.1;
  EXPECT_THROW(run("T8", {0}), SetupError);
}

TEST_F(Experiments, LeaveEachEnvironmentOutInTurn) {
  EXPECT_THROW(run("T2a", {0}), SetupError) << "one environment, and nothing to pre-train on";
  data_.real.push_back(folder("there", 40, 5));
  data_.test.push_back(folder("there-test", 20, 6));
  data_.objects = {folder("objects", 40, 7)};
  const auto results = run("T2a", {0});
  const auto& each_mm = results[0].environments_mm;
  ASSERT_EQ(each_mm.size(), 2u);
  EXPECT_GT(std::min(each_mm[0], each_mm[1]), 10);
  EXPECT_NE(each_mm[0], each_mm[1]);
  EXPECT_DOUBLE_EQ(results[0].error_mm, (each_mm[0] + each_mm[1]) / 2);
  for (const char* out : {"without-0", "without-1"})
    EXPECT_TRUE(fs::exists(fs::path(settings_.run.out) / "T2a-seed0" / out / "finetune/best.safetensors"))
        << out;
}

// Of the environment that is left out nothing is learnt but, where backgrounds are taken off, its own background.
TEST_F(Experiments, TheEnvironmentLeftOutTellsItsBackgroundAndNothingElse) {
  data_.test.push_back(folder("there-test", 20, 6));
  data_.objects = {folder("objects", 40, 7)};
  const auto error_there_mm = [&](const std::string& norm, const std::string& there) {
    settings_.data.norm = norm;
    settings_.run.out = scratch_ / (norm + " " + fs::path(there).filename().string());
    ExperimentData data = data_;
    data.real.push_back(there);
    return run_experiment(experiment_named("T2a"), settings_, data, {0})[0].environments_mm[1];
  };
  const std::string there = folder("there", 40, 5), somewhere = folder("somewhere", 40, 8);
  EXPECT_EQ(error_there_mm("corpus", there), error_there_mm("corpus", somewhere));
  EXPECT_NE(error_there_mm("background", there), error_there_mm("background", somewhere));
}

TEST_F(Experiments, RefuseRowsThatThereAreNotAndDataThatIsMissing) {
  EXPECT_THROW(experiment_named("T9"), SetupError);
  EXPECT_THROW(run("T5b", {0}), SetupError) << "no --objects";
}

}  // namespace
}  // namespace csipose::train
