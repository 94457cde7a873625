#include "model/infer.h"

#include <gtest/gtest.h>
#include <unistd.h>

#include <cmath>
#include <filesystem>
#include <fstream>
#include <nlohmann/json.hpp>

#include "model/model.h"
#include "proto/npy.h"
#include "proto/result.h"

namespace csipose {
namespace {

constexpr std::size_t kWindowNumbers = kChannels * kTokens;

class Infer : public ::testing::Test {
 protected:
  Infer()
      : folder(std::filesystem::path(::testing::TempDir()) /
               ("csipose_infer_" + std::to_string(::getpid()))) {
    std::filesystem::create_directories(folder);
    for (std::size_t i = 0; i < windows.size(); ++i) windows[i] = std::sin(0.7f * static_cast<float>(i));
    job.tensors = folder / "x.npy";
    job.folder = folder / "out" / "deep";
    write({2, kChannels, kSamples, kLinks});
  }
  ~Infer() override { std::filesystem::remove_all(folder); }
  void write(const NpyShape& shape) {
    write_npy<float>(job.tensors, shape, std::span(windows).first(element_count(shape)));
  }
  NpyArray<float> read(const std::string& name) { return read_npy<float>(job.folder / (name + ".npy")); }
  std::string refusal() {
    try {
      infer_file(*engine, *model, job);
    } catch (const SetupError& error) {
      return error.what();
    }
    return "";
  }
  static std::shared_ptr<const Model> make_model() {
    NetworkConfig config = preset_config("micro");
    config.joint_sigma = true;
    return init_random(config, 3, HeadInit::random);
  }

  std::filesystem::path folder;
  std::vector<float> windows = std::vector<float>(2 * kWindowNumbers);
  std::shared_ptr<const Model> model = make_model();
  std::unique_ptr<Engine> engine = make_reference_engine(model);
  InferJob job;
};

TEST_F(Infer, WritesWhatTheEngineAnswers) {
  EXPECT_EQ(infer_file(*engine, *model, job), 2u);
  EXPECT_EQ(read("logits").shape, (NpyShape{2, 8}));
  EXPECT_EQ(read("sigma_m").shape, (NpyShape{2, 8, 14}));
  const auto poses = read("poses"), scores = read("scores");
  ASSERT_EQ(poses.shape, (NpyShape{2, 8, 14, 3}));
  const NetworkOutput second = engine->run(std::span(windows).subspan(kWindowNumbers), LinkSet().set());
  EXPECT_TRUE(std::equal(second.poses.begin(), second.poses.end(), poses.data.begin() + 8 * 42));
  for (std::size_t q = 0; q < 8; ++q)
    EXPECT_NEAR(scores.data[8 + q], 1 / (1 + std::exp(-second.logits[q])), 1e-6);
}

TEST_F(Infer, WritesEveryStageInTheShapeItIsSaidToHave) {
  job.stages = stage_names(model->config());
  job.links = LinkSet(0b111000111);
  infer_file(*engine, *model, job);
  for (const std::string& stage : job.stages) {
    NpyShape shape = stage_shape(model->config(), job.links, stage);
    shape.insert(shape.begin(), 2);
    EXPECT_EQ(read(stage).shape, shape) << stage;
  }
  EXPECT_EQ(read("encoder").shape, (NpyShape{2, 120, 64}));
  const auto kept = engine->stage("memory");
  const auto memory = read("memory");
  EXPECT_TRUE(
      std::equal(kept.begin(), kept.end(), memory.data.end() - static_cast<std::ptrdiff_t>(kept.size())));
}

TEST_F(Infer, TellsWhatMadeTheArrays) {
  job.links = LinkSet(0b111);
  infer_file(*engine, *model, job);
  const auto account = nlohmann::json::parse(std::ifstream(job.folder / "infer.json"));
  EXPECT_EQ(account["sha256"], model->digest());
  EXPECT_EQ(account["untrained"], true);
  EXPECT_EQ(account["links"], (std::vector<int>{0, 1, 2}));
  EXPECT_EQ(account["arrays"]["poses"], (std::vector<int>{2, 8, 14, 3}));
}

TEST_F(Infer, TakesOneWindowAndNone) {
  write({kChannels, kSamples, kLinks});
  EXPECT_EQ(infer_file(*engine, *model, job), 1u);
  write({0, kChannels, kSamples, kLinks});
  EXPECT_EQ(infer_file(*engine, *model, job), 0u);
  EXPECT_EQ(read("poses").shape, (NpyShape{0, 8, 14, 3}));
}

TEST_F(Infer, RefusesInWords) {
  job.stages = {"block7"};
  EXPECT_NE(refusal().find("no stage 'block7'; it has embed, block0, block1, encoder"), std::string::npos)
      << refusal();
  job.stages.clear();
  job.links.reset();
  EXPECT_NE(refusal().find("at least one"), std::string::npos);
  job.links.set();
  windows[kWindowNumbers + 4] = NAN;
  write({2, kChannels, kSamples, kLinks});
  EXPECT_NE(refusal().find("window 1 has a number that is not finite in link 4"), std::string::npos)
      << refusal();
  job.links.reset(4);
  EXPECT_EQ(refusal(), "");
  write({2, kSamples, kChannels, kLinks});
  EXPECT_NE(refusal().find("(2, 20, 60, 9)"), std::string::npos);
  job.tensors = folder / "nowhere.npy";
  EXPECT_NE(refusal().find("nowhere.npy"), std::string::npos);
}

TEST_F(Infer, RefusesAFolderThatCannotBe) {
  std::ofstream(folder / "file") << "x";
  job.folder = folder / "file" / "out";
  EXPECT_NE(refusal().find("cannot make the folder"), std::string::npos) << refusal();
}

}  // namespace
}  // namespace csipose
