// What ships is what is measured: the engine's own answers as labels give no error, and the trivial answers have closed forms.
#include "train/evaluation.h"

#include <unistd.h>

#include <cmath>

#include "model/config.h"
#include "proto/npy.h"
#include "tests/model/made_up_background.h"
#include "train/pack.h"
#include "train/report_differences.h"

namespace csipose::train {
namespace {

/// Windows in memory.
class MadeUp : public WindowSource {
 public:
  explicit MadeUp(std::vector<std::vector<Skeleton>> people, std::vector<std::uint64_t> clips)
      : people_(std::move(people)), clips_(std::move(clips)) {}
  std::size_t size() const override { return people_.size(); }
  std::string name() const override { return "made-up"; }
  void read(std::size_t i, std::span<float> x) const override {
    std::mt19937 random(static_cast<unsigned>(i));
    std::uniform_real_distribution<float> numbers(-1, 1);
    for (float& number : x) number = numbers(random);
  }
  std::span<const Skeleton> people(std::size_t i) const override { return people_[i]; }
  std::uint64_t clip(std::size_t i) const override { return clips_[i]; }
  std::string clip_name(std::size_t i) const override {
    return numbered_in_.empty() ? std::string() : numbered_in_ + std::to_string(clips_[i]);
  }

  std::vector<std::vector<Skeleton>> people_;
  std::string numbered_in_;  ///< a set

 private:
  std::vector<std::uint64_t> clips_;
};

Skeleton standing(float x, float y) {
  Skeleton pose;
  for (std::size_t j = 0; j < kJoints; ++j) pose[j] = {x, y, 0.1f * static_cast<float>(j)};
  return pose;
}
EvaluationSet set_of(const std::shared_ptr<MadeUp>& windows, std::vector<std::uint8_t> rooms) {
  return {windows, std::move(rooms)};
}
const TrivialFigures& figures_of(const std::vector<TrivialFigures>& rows, const std::string& name) {
  for (const TrivialFigures& row : rows)
    if (row.name == name) return row;
  throw std::runtime_error("no row " + name);
}

TEST(EvaluateModel, ItsOwnAnswersAreRight) {
  const auto model = init_random(preset_config("micro"), 3, HeadInit::random);
  const auto engine = make_reference_engine(model);
  auto windows =
      std::make_shared<MadeUp>(std::vector<std::vector<Skeleton>>(3), std::vector<std::uint64_t>{0, 0, 1});
  std::vector<float> x(kChannels * kTokens);
  for (std::size_t i = 0; i < 3; ++i) {
    windows->read(i, x);
    const NetworkOutput output = engine->run(x, LinkSet().set());
    Skeleton& person = windows->people_[i].emplace_back();
    for (std::size_t j = 0; j < kJoints; ++j) {
      const float* xyz_m = &output.poses[2 * kPoseWidth + 3 * j];  // the third query's
      person[j] = {xyz_m[0] + 0.03f, xyz_m[1], xyz_m[2]};
    }
  }
  const EvaluationSet set = set_of(windows, {0, 0, 0});
  const Metrics whole = evaluate_model(*engine, *model, set, LinkSet().set()).piw3d;
  EXPECT_LE(whole.all().frame_mean.mpjpe, 30 + 1e-3);
  EXPECT_GT(whole.all().frame_mean.mpjpe, 0);
  EXPECT_EQ(whole.all().frames, 3u);
  const Metrics one_lost = evaluate_model(*engine, *model, set, LinkSet(0b000111111)).piw3d;
  EXPECT_NE(one_lost.all().frame_mean.mpjpe, whole.all().frame_mean.mpjpe);
}

TEST(EvaluateModel, DetectGivesWhatPassesTheThreshold) {
  const auto model = init_random(preset_config("micro"), 3, HeadInit::zero);  // every score is 1 %
  const auto engine = make_reference_engine(model);
  const auto windows = std::make_shared<MadeUp>(std::vector<std::vector<Skeleton>>{{standing(1, 1)}, {}},
                                                std::vector<std::uint64_t>{0, 0});
  const GroupMetrics detect =
      evaluate_model(*engine, *model, set_of(windows, {0, 0}), LinkSet().set()).detect.all();
  EXPECT_EQ(detect.predicted, 0u);
  EXPECT_EQ(detect.count_accuracy(), 0.5);
  EXPECT_EQ(detect.penalised_500, 500);
}

/// Windows of clips in front of backgrounds, and what they say of their installation.
class Received : public MadeUp {
 public:
  struct Clip {
    Background from;
    std::string named;
  };
  explicit Received(std::vector<Clip> clips)
      : MadeUp(std::vector<std::vector<Skeleton>>(2 * clips.size()),
               std::vector<std::uint64_t>(2 * clips.size())),
        received_(std::move(clips)) {}
  void read(std::size_t i, std::span<float> x) const override {
    std::ranges::copy(testing::window_before(received_[i / 2].from, i), x.begin());
  }
  std::string room(std::size_t i) const override { return received_[i / 2].named; }
  std::uint64_t clip(std::size_t i) const override { return i / 2; }

 private:
  std::vector<Clip> received_;
};

TEST(EvaluateModel, SaysWhatBecameOfTheInstallations) {
  const Background den = testing::made_up_background("den", 1), hall = testing::made_up_background("hall", 2);
  const auto model =
      testing::with_backgrounds(random_weights(preset_config("micro"), 5, HeadInit::zero), {den, hall});
  const auto engine = make_reference_engine(model);
  const auto windows = std::make_shared<Received>(std::vector<Received::Clip>{
      {den, "den"}, {hall, "den"}, {hall, "attic"}, {testing::made_up_background("", 3), "cellar"}});
  const Installations found =
      evaluate_model(*engine, *model, set_of(windows, std::vector<std::uint8_t>(8)), LinkSet().set())
          .installations;
  EXPECT_EQ(found.windows, 8u);
  EXPECT_EQ(found.named, 4u) << "nothing is known of attic and cellar";
  EXPECT_EQ(found.mistaken, 2u);
  EXPECT_EQ(found.unknown, 2u) << "the cellar's";
  EXPECT_GT(found.greatest_unlikeness, 10);
}

/// Random weights whose every query has a logit near `bias`, and whose joints state their expected errors.
std::shared_ptr<const Model> model_with_logits_near(float bias) {
  NetworkConfig config = preset_config("micro");
  config.joint_sigma = true;
  const auto file = SafetensorsFile::parse(random_weights(config, 3, HeadInit::random), "draft");
  std::vector<TensorView> tensors = file.tensors();
  for (TensorView& view : tensors)
    if (view.name == "cls_branches.0.bias") view.bytes = ByteView(&bias, sizeof(bias));
  return Model::from(SafetensorsFile::parse(pack_safetensors(file.metadata(), tensors), "made by the test"));
}

TEST(EvaluateModel, WhatIsStatedIsComparedWithWhatCameTrue) {
  const auto model = model_with_logits_near(2);
  const auto engine = make_reference_engine(model);
  const auto windows =
      std::make_shared<MadeUp>(std::vector<std::vector<Skeleton>>(4), std::vector<std::uint64_t>{0, 0, 0, 0});
  const EvaluationSet set = set_of(windows, {0, 0, 0, 0});
  std::vector<Answer> alone;
  const Evaluation nobody_there = evaluate_model(*engine, *model, set, LinkSet().set(),
                                                 [&](const Answer& answer) { alone.push_back(answer); });
  EXPECT_EQ(nobody_there.joints.count(), 0u) << "who is not there has no error";
  double scores = 0;
  for (const Answer& answer : alone) {
    ASSERT_FALSE(answer.found.empty());
    for (const Detection& detection : answer.found) {
      EXPECT_EQ(detection.match, kMissed);
      EXPECT_EQ(person_score(detection.logit, {}), detection.person.score);
      EXPECT_EQ(detection.sigma_m, detection.person.sigma_m) << "nothing calibrated";
      scores += static_cast<double>(detection.person.score) / static_cast<double>(nobody_there.score.count());
    }
    // Now the best of them is there, all joints 40 mm aside but one, which is a foot away.
    Skeleton& person = windows->people_[answer.window].emplace_back(answer.found.front().person.joints);
    for (Point3& joint : person) joint.y += 0.04f;
    person[9].y += 0.3f;
  }
  EXPECT_NEAR(nobody_there.score.expected_error(), scores, 1e-6) << "said so often, true never";

  const Evaluation there = evaluate_model(*engine, *model, set, LinkSet().set(), [](const Answer& answer) {
    const Detection& best = answer.found.front();
    ASSERT_EQ(best.match, 0u);
    EXPECT_NEAR(best.error_m[8], 0.04, 1e-5);
    EXPECT_NEAR(best.error_m[9], 0.34, 1e-5);
  });
  EXPECT_EQ(there.score.count(), nobody_there.score.count());
  EXPECT_EQ(there.joints.count(), 4 * kJoints);
  double confidence = 0;  // of one joint: in random weights much the same for all
  for (const float value : alone.front().found.front().person.confidence)
    confidence += static_cast<double>(value) / kJoints;
  EXPECT_NEAR(there.joints.expected_error(), std::abs(13. / 14 - confidence), 0.02);
}

TEST(EvaluateModel, TheFaintAreMatchedToThoseWhoAreLeft) {
  const auto model = model_with_logits_near(-6);
  const auto engine = make_reference_engine(model);
  const auto windows =
      std::make_shared<MadeUp>(std::vector<std::vector<Skeleton>>(1), std::vector<std::uint64_t>{0});
  const EvaluationSet set = set_of(windows, {0});
  const auto ask = [&] {
    Answer seen;
    const Evaluation figures =
        evaluate_model(*engine, *model, set, LinkSet().set(), [&](const Answer& answer) { seen = answer; });
    EXPECT_EQ(figures.score.count(), 0u) << "nobody is said to be there";
    EXPECT_EQ(figures.detect.all().predicted, 0u);
    return seen;
  };
  const Answer alone = ask();
  EXPECT_TRUE(alone.found.empty());
  ASSERT_FALSE(alone.faint.empty());
  EXPECT_EQ(alone.faint.front().match, kMissed);
  windows->people_[0] = {standing(50, 50), alone.faint.front().person.joints};
  const Answer there = ask();
  EXPECT_EQ(there.faint.front().match, 1u);
  EXPECT_EQ(there.faint.front().error_m[0], 0);
}

TEST(EvaluateTrivial, ClosedForms) {
  const auto training = std::make_shared<MadeUp>(
      std::vector<std::vector<Skeleton>>{{standing(0, 0)}, {standing(2, 0)}, {standing(5, 0)}},
      std::vector<std::uint64_t>{0, 0, 1});
  const auto windows = std::make_shared<MadeUp>(
      std::vector<std::vector<Skeleton>>{{standing(1, 0.3f)}, {standing(1, 0.5f)}, {standing(5, 0.1f)}},
      std::vector<std::uint64_t>{7, 7, 8});
  const auto rows =
      evaluate_trivial(set_of(training, {0, 0, 1}), set_of(windows, {0, 0, 1}), kIdentityTransform);
  EXPECT_NEAR(figures_of(rows, "mean_at_root").assigned.all().frame_mean.mpjpe, 0, 1e-3);
  EXPECT_NEAR(figures_of(rows, "mean_at_room").assigned.all().frame_mean.mpjpe, (300 + 500 + 100) / 3., 1e-3);
  const double far =
      1000. * (std::hypot(4 / 3., 0.3) + std::hypot(4 / 3., 0.5) + std::hypot(8 / 3., 0.1)) / 3;
  EXPECT_NEAR(figures_of(rows, "mean_pose").assigned.all().frame_mean.mpjpe, far, 1e-2);
  EXPECT_EQ(figures_of(rows, "mean_pose").detect.all().matched, 0u) << "nobody is within half a metre of it";
  const GroupMetrics last = figures_of(rows, "last_pose").assigned.all();
  EXPECT_NEAR(last.frame_mean.mpjpe, 200, 1e-3);
  EXPECT_EQ(last.frames_unmatched, 2u) << "first windows of clips have no window before them";
}

TEST(EvaluateTrivial, WhereClipsAreSharedTheLastThatWasSeenOfThemIsAnAnswer) {
  const auto training = std::make_shared<MadeUp>(
      std::vector<std::vector<Skeleton>>{{standing(0, 0)}, {standing(2, 0)}, {standing(5, 0)}},
      std::vector<std::uint64_t>{7, 7, 9});
  const auto windows = std::make_shared<MadeUp>(
      std::vector<std::vector<Skeleton>>{{standing(2, 0.3f)}, {standing(2, 0.1f)}, {standing(5, 0)}},
      std::vector<std::uint64_t>{7, 7, 8});
  const auto rows = [&] {
    return evaluate_trivial(set_of(training, {0, 0, 0}), set_of(windows, {0, 0, 0}), kIdentityTransform);
  };
  EXPECT_EQ(rows().size(), 5u) << "not known to be the same clips";
  training->numbered_in_ = "morning";
  windows->numbered_in_ = "evening";
  EXPECT_EQ(rows().size(), 5u) << "known to be others";
  windows->numbered_in_ = "morning";
  const GroupMetrics seen = figures_of(rows(), "last_seen").assigned.all();
  EXPECT_NEAR(seen.frame_mean.mpjpe, 200, 1e-3);
  EXPECT_EQ(seen.frames_unmatched, 1u) << "nothing was seen of clip 8";
  windows->people_[2] = {};
  EXPECT_EQ(figures_of(rows(), "last_seen").assigned.all().predicted, 2u);
}

/// Who stands with the left shoulder and hip at the root and right ones beside them.
Skeleton turned_to(float x, float y, float angle_rad) {
  Skeleton pose = standing(x, y);
  for (const std::size_t joint : {kRightShoulder, kRightHip})
    pose[joint] = {x + 0.4f * std::cos(angle_rad), y + 0.4f * std::sin(angle_rad), pose[joint].z};
  return pose;
}

TEST(EvaluateTrivial, FacingIsToldToTheOneThatTurns) {
  const auto training = std::make_shared<MadeUp>(
      std::vector<std::vector<Skeleton>>{{turned_to(0, 0, 0.4f)}, {turned_to(2, 0, -2)}},
      std::vector<std::uint64_t>{0, 1});
  const auto windows = std::make_shared<MadeUp>(
      std::vector<std::vector<Skeleton>>{{turned_to(1, 3, 3)}, {turned_to(4, 1, -1)}},
      std::vector<std::uint64_t>{0, 1});
  const auto rows = evaluate_trivial(set_of(training, {0, 0}), set_of(windows, {0, 0}), kIdentityTransform);
  const PoseErrors told = figures_of(rows, "mean_facing").assigned.all().frame_mean;
  EXPECT_NEAR(told.mpjpe, 0, 1e-3);
  EXPECT_NEAR(told.facing_deg, 0, 0.05);
  const PoseErrors not_told = figures_of(rows, "mean_at_root").assigned.all().frame_mean;
  EXPECT_NEAR(not_told.mrpe, 0, 1e-3);
  EXPECT_GT(not_told.root_mpjpe, 10);
}

// What ships is the network in half the bytes, and nothing else.
TEST(Pack, KeepsTheNetworkToFloat16AndDropsWhatOnlyTrainingNeeds) {
  std::map<std::string, std::string> metadata;
  SafetensorsFile whole =
      SafetensorsFile::parse(random_weights(preset_config("micro"), 4, HeadInit::random), "whole");
  metadata = whole.metadata();
  metadata["progress"] = "{}";
  std::vector<TensorView> views = whole.tensors();
  views.push_back(*whole.find("encoder.norm.bias"));
  views.back().name = "target_encoder.norm.bias";
  whole = SafetensorsFile::parse(pack_safetensors(metadata, views), "whole");

  const SafetensorsFile packed =
      SafetensorsFile::parse(pack_for_shipping(whole, {{"metrics", "{\"a\":1}"}}), "packed");
  EXPECT_TRUE(packed.sealed());
  EXPECT_EQ(packed.metadata().count("progress"), 0u);
  EXPECT_EQ(packed.metadata().at("metrics"), "{\"a\":1}");
  EXPECT_EQ(packed.find("target_encoder.norm.bias"), nullptr);
  EXPECT_EQ(packed.tensors().size() + 1, whole.tensors().size());
  for (const TensorView& tensor : packed.tensors()) {
    EXPECT_EQ(tensor.dtype, tensor.name.rfind("norm.", 0) == 0 ? DType::f32 : DType::f16) << tensor.name;
    const std::vector<float> half = to_floats(tensor), full = to_floats(*whole.find(tensor.name));
    for (std::size_t i = 0; i < full.size(); ++i)
      ASSERT_NEAR(half[i], full[i], std::ldexp(std::fabs(full[i]), -11) + 6e-8) << tensor.name;
  }
  EXPECT_NO_THROW(Model::from(packed));
}

TEST(Pack, KnowsOnlyTheInstallationsThatAreNamed) {
  const auto file = SafetensorsFile::parse(
      with_backgrounds(
          SafetensorsFile::parse(random_weights(preset_config("micro"), 4, HeadInit::random), "plain"),
          {testing::made_up_background("den", 1), testing::made_up_background("hall", 2),
           testing::made_up_background("loft", 3)}),
      "three");
  const auto model = Model::from(knowing_only(file, {"loft", "den"}));
  const auto& kept = model->normalisation().backgrounds;
  ASSERT_EQ(kept.size(), 2u);
  EXPECT_EQ(kept[0].response, testing::made_up_background("loft", 3).response);
  EXPECT_EQ(kept[1].name, "den");
  try {
    (void)knowing_only(file, {"attic"});
    FAIL();
  } catch (const SetupError& error) {
    EXPECT_STREQ(error.what(), "three knows no installation 'attic'; it knows den; hall; loft");
  }
}

TEST(Pack, RefusesWhatFloat16HasNot) {
  const SafetensorsFile whole =
      SafetensorsFile::parse(random_weights(preset_config("micro"), 4, HeadInit::random), "whole");
  std::vector<TensorView> views = whole.tensors();
  std::vector<float> large = to_floats(views[3]);
  large[0] = 7e4f;
  views[3].bytes =
      ByteView(reinterpret_cast<const std::uint8_t*>(large.data()), large.size() * sizeof(float));
  const SafetensorsFile broken = SafetensorsFile::parse(pack_safetensors(whole.metadata(), views), "broken");
  EXPECT_THROW(pack_for_shipping(broken, {}), SetupError);
}

TEST(EvaluationSets, AreOneAfterTheOther) {
  const auto folder =
      std::filesystem::temp_directory_path() / ("csipose_joined_" + std::to_string(::getpid()));
  std::vector<std::string> names;
  for (int f = 0; f < 2; ++f) {
    names.push_back((folder / std::to_string(f)).string());
    std::filesystem::create_directories(names.back());
    const std::vector<float> windows(2 * kChannels * kTokens, static_cast<float>(f)),
        labels(2 * kPoseWidth, static_cast<float>(f + 1));
    const std::vector<std::uint32_t> clips = {3, 3};
    const std::vector<std::uint8_t> rooms = {0, static_cast<std::uint8_t>(1 - f)};
    write_npy<float>(names.back() + "/windows.npy", {2, kChannels, kSamples, kLinks}, windows);
    write_npy<float>(names.back() + "/labels.npy", {2, 1, kJoints, 3}, labels);
    write_npy<std::uint32_t>(names.back() + "/clip.npy", {2}, clips);
    write_npy<std::uint8_t>(names.back() + "/room.npy", {2}, rooms);
  }
  const EvaluationSet set = open_evaluation_sets(names);
  ASSERT_EQ(set.windows->size(), 4u);
  EXPECT_EQ(set.rooms, (std::vector<std::uint8_t>{0, 1, 2, 2}));
  EXPECT_NE(set.windows->clip(1), set.windows->clip(2));
  EXPECT_EQ(set.windows->clip(2), set.windows->clip(3));
  EXPECT_EQ(set.windows->people(1)[0][0].x, 1);
  EXPECT_EQ(set.windows->people(2)[0][0].x, 2);
  std::vector<float> x(kChannels * kTokens);
  set.windows->read(3, x);
  EXPECT_EQ(x[0], 1);
  std::filesystem::remove_all(folder);
}

TEST(ReportDifferences, NamesWhatDisagrees) {
  const auto report = nlohmann::json::parse(
      R"({"sha256":"ab","results":{"model":{"detect":{"all":{"mpjpe":200.0,"n":3},"per_joint":[1,2]}}}})");
  EXPECT_TRUE(report_differences(report, report, 0.005).empty());
  nlohmann::json other = report;
  other["results"]["model"]["detect"]["all"]["mpjpe"] = 200.9;
  other["results"]["more"] = 1;
  EXPECT_TRUE(report_differences(report, other, 0.005).empty());
  other["results"]["model"]["detect"]["all"]["mpjpe"] = 201.1;
  ASSERT_EQ(report_differences(report, other, 0.005).size(), 1u);
  EXPECT_NE(report_differences(report, other, 0.005)[0].find("mpjpe"), std::string::npos);
  other = report;
  other["sha256"] = "cd";
  other["results"]["model"]["detect"]["per_joint"] = {1};
  EXPECT_EQ(report_differences(report, other, 0.005).size(), 2u);
  EXPECT_FALSE(report_differences(nlohmann::json::object(), report, 0.005).empty());
}

}  // namespace
}  // namespace csipose::train
