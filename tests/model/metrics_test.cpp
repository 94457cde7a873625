// The figures by which methods are compared: who goes with whom, what is counted, and the golden frames.
#include "model/metrics.h"

#include <nlohmann/json.hpp>

#include "tests/model/made_up_poses.h"
#include "tests/shared_data.h"

namespace csipose {
namespace {

using testing::leaning;
using testing::moved;
using testing::standing_person;

TEST(Match, GreedyTakesTheNearestPairFirstAndOptimalTheLeastSum) {
  const std::vector<Skeleton> people = {Skeleton{}, moved(Skeleton{}, {0.3f, 0, 0})};
  const std::vector<Skeleton> predicted = {moved(Skeleton{}, {0.2f, 0, 0}), moved(Skeleton{}, {0.45f, 0, 0})};
  EXPECT_EQ(match(Protocol::piw3d, predicted, people), (std::vector<std::size_t>{1, 0}));
  EXPECT_EQ(match(Protocol::detect, predicted, people), (std::vector<std::size_t>{0, 1}));
  EXPECT_EQ(match(Protocol::assigned, predicted, people), (std::vector<std::size_t>{0, 1}));
}

TEST(Match, FixedAnswersAreAssignedHoweverFar) {
  const std::vector<Skeleton> people = {Skeleton{}, moved(Skeleton{}, {3, 0, 0})};
  const std::vector<Skeleton> fixed(2, moved(Skeleton{}, {-9, 0, 0}));
  EXPECT_EQ(match(Protocol::assigned, fixed, people), (std::vector<std::size_t>{0, 1}));
  EXPECT_EQ(match(Protocol::detect, fixed, people), (std::vector<std::size_t>{kMissed, kMissed}));
}

TEST(Match, TooFewPredictions) {
  const std::vector<Skeleton> people = {Skeleton{}, moved(Skeleton{}, {3, 0, 0})};
  const std::vector<Skeleton> one = {Skeleton{}};
  EXPECT_EQ(match(Protocol::piw3d, one, people), (std::vector<std::size_t>{0, 0}));
  EXPECT_EQ(match(Protocol::detect, one, people), (std::vector<std::size_t>{0, kMissed}));
  EXPECT_EQ(match(Protocol::assigned, one, people), (std::vector<std::size_t>{0, kMissed}));
  EXPECT_EQ(match(Protocol::piw3d, {}, people), (std::vector<std::size_t>{kMissed, kMissed}));
}

TEST(Metrics, CountsWhoWasMissedAndWhoWasMadeUp) {
  Metrics metrics(Protocol::detect);
  const std::vector<Skeleton> here = {Skeleton{}}, there = {moved(Skeleton{}, {2, 0, 0})};
  metrics.add(here, here);
  metrics.add(there, here);
  metrics.add({}, {});
  const GroupMetrics all = metrics.all();
  EXPECT_EQ(all.frames, 3u);
  EXPECT_EQ(all.frames_unmatched, 1u);
  EXPECT_EQ(all.frame_mean.mpjpe, 0);
  EXPECT_EQ(all.penalised_500, 250);
  EXPECT_EQ(all.precision(), 0.5);
  EXPECT_EQ(all.recall(), 0.5);
  EXPECT_EQ(all.count_accuracy(), 1);
  EXPECT_EQ(metrics.by_count().at(0).frames, 1u);
  EXPECT_TRUE(nlohmann::json::parse(metrics_json(metrics))["by_count"]["0"]["mpjpe"].is_null());
}

TEST(Metrics, ByPosture) {
  Metrics metrics(Protocol::detect);
  const Skeleton upright = standing_person(), bent = leaning(upright, 60);
  metrics.add(std::vector{moved(upright, {0.1f, 0, 0})}, std::vector{upright});
  metrics.add(std::vector{upright}, std::vector{upright, moved(bent, {3, 0, 0})});
  EXPECT_EQ(metrics.by_posture(Posture::upright).people, 2u);
  EXPECT_EQ(metrics.by_posture(Posture::upright).matched, 2u);
  EXPECT_NEAR(metrics.by_posture(Posture::upright).person_mean.mpjpe, 50, 1e-3);
  EXPECT_EQ(metrics.by_posture(Posture::bent).people, 1u);
  EXPECT_EQ(metrics.by_posture(Posture::bent).matched, 0u);
  const auto json = nlohmann::json::parse(metrics_json(metrics))["by_posture"];
  EXPECT_EQ(json["upright"]["recall"], 1);
  EXPECT_TRUE(json["bent"]["mpjpe"].is_null());
  EXPECT_EQ(json["low"]["people"], 0);
}

std::vector<Skeleton> skeletons(const nlohmann::json& poses) {
  std::vector<Skeleton> result;
  for (const nlohmann::json& pose : poses) {
    Skeleton& skeleton = result.emplace_back();
    for (std::size_t j = 0; j < kJoints; ++j) skeleton[j] = {pose[j][0], pose[j][1], pose[j][2]};
  }
  return result;
}

void expect_errors(const PoseErrors& found, const nlohmann::json& expected, const std::string& where) {
  EXPECT_NEAR(found.mpjpe, expected["mpjpe"], 0.01) << where;
  EXPECT_NEAR(found.axis[0], expected["h"], 0.01) << where;
  EXPECT_NEAR(found.axis[1], expected["v"], 0.01) << where;
  EXPECT_NEAR(found.axis[2], expected["d"], 0.01) << where;
  EXPECT_NEAR(found.pa_mpjpe, expected["pa"], 0.01) << where;
  EXPECT_NEAR(found.pck20, expected["pck20_torso"], 0.01) << where;
  EXPECT_NEAR(found.pck50, expected["pck50_torso"], 0.01) << where;
  EXPECT_NEAR(found.pck20_elbows, expected["pck20_dtpose"], 0.01) << where;
  EXPECT_NEAR(found.pck50_elbows, expected["pck50_dtpose"], 0.01) << where;
  EXPECT_NEAR(found.pck20mm, expected["pck20mm"], 0.01) << where;
  EXPECT_NEAR(found.pck50mm, expected["pck50mm"], 0.01) << where;
}

void expect_group(const GroupMetrics& found, const nlohmann::json& expected, const std::string& where) {
  EXPECT_EQ(found.frames, expected["frames"]) << where;
  expect_errors(found.frame_mean, expected["frame_mean"], where + ", frame mean");
  expect_errors(found.person_mean, expected["person_mean"], where + ", person mean");
  EXPECT_NEAR(found.penalised_500, expected["mpjpe_penalised_500"], 0.01) << where;
  for (std::size_t j = 0; j < kJoints; ++j)
    EXPECT_NEAR(found.per_joint[j], expected["per_joint_mpjpe"][j], 0.01) << where << ", joint " << j;
}

void expect_golden(Protocol protocol, const std::string& name, float min_score) {
  const auto read = [](const std::string& file) {
    std::ifstream in(testing::shared_data("model/metrics/" + file));
    return nlohmann::json::parse(in);
  };
  Metrics metrics(protocol);
  for (const nlohmann::json& frame : read("frames.json")) {
    const std::vector<Skeleton> all = skeletons(frame["pred"]);
    std::vector<Skeleton> kept;
    for (std::size_t i = 0; i < all.size(); ++i)
      if (frame["score"][i].get<float>() >= min_score) kept.push_back(all[i]);
    metrics.add(kept, skeletons(frame["gt"]));
  }
  const nlohmann::json expected = read("expected_" + name + ".json");
  expect_group(metrics.all(), expected["all"], name);
  for (const auto& [count, group] : metrics.by_count())
    expect_group(group, expected["by_count"][std::to_string(count)],
                 fmt::format("{}, {} people", name, count));
}

TEST(Metrics, GoldenFrames) {
  CSIPOSE_NEEDS_SHARED_DATA();
  expect_golden(Protocol::piw3d, "piw3d", 0);
  expect_golden(Protocol::detect, "detect", 0.3f);
}

}  // namespace
}  // namespace csipose
