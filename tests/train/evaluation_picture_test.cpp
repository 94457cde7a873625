// Pictures of known answers: what stands where, in which ink, and how high.
#include "train/evaluation_picture.h"

#include "drawing/brush.h"

namespace csipose::train {
namespace {

/// Only who is where.
class People : public WindowSource {
 public:
  explicit People(std::vector<std::size_t> counts) {
    for (const std::size_t count : counts) people_.emplace_back(count);
  }
  std::size_t size() const override { return people_.size(); }
  std::string name() const override { return "people"; }
  void read(std::size_t, std::span<float>) const override {}
  std::span<const Skeleton> people(std::size_t i) const override { return people_[i]; }
  std::uint64_t clip(std::size_t) const override { return 0; }

 private:
  std::vector<std::vector<Skeleton>> people_;
};

/// 1.8 m high; left joints 0.4 m to the left (smaller x) of `x_m`, right ones to the right.
Skeleton standing(float x_m) {
  Skeleton pose;
  for (std::size_t j = 0; j < kJoints; ++j) {
    const bool left = kJointNames[j].starts_with("left"), right = kJointNames[j].starts_with("right");
    pose[j] = {x_m + (left ? -0.4f : right ? 0.4f : 0), 2, 1.8f - 0.13f * static_cast<float>(j)};
  }
  return pose;
}

Detection found(const Skeleton& joints, float error_m) {
  Detection detection;
  detection.person.joints = joints;
  detection.match = 0;
  detection.error_m.fill(error_m);
  return detection;
}

struct Place {
  double x = 0, y = 0;
  std::size_t count = 0;
};
/// Middle of the pixels that have this ink, unmixed.
Place middle_of(const cv::Mat& picture, const Ink& ink) {
  Place place;
  for (int y = 0; y < picture.rows; ++y)
    for (int x = 0; x < picture.cols; ++x) {
      const auto& pixel = picture.at<cv::Vec3b>(y, x);
      if (cv::Scalar(pixel[0], pixel[1], pixel[2]) != ink) continue;
      place = {place.x + x, place.y + y, place.count + 1};
    }
  const auto count = static_cast<double>(place.count);
  return {place.x / count, place.y / count, place.count};
}

TEST(SpreadWindows, EvenlyOverThoseWithPeople) {
  const People windows({1, 0, 1, 1, 2, 0, 1, 1, 1, 3});  // eight with people
  EXPECT_EQ(spread_windows(windows, 2), (std::vector<std::size_t>{3, 8}));
  EXPECT_EQ(spread_windows(windows, 1), (std::vector<std::size_t>{6}));
  EXPECT_EQ(spread_windows(windows, 100), (std::vector<std::size_t>{0, 2, 3, 4, 6, 7, 8, 9}));
  EXPECT_TRUE(spread_windows(People({0, 0}), 3).empty());
}

TEST(Sheet, LeftIsLeftAndUpIsUp) {
  Answer answer{0, {}, {standing(1), standing(3)}, {}, {}, {}};
  EXPECT_EQ(middle_of(draw_sheet({{answer}}, "none"), kLeftInk).count, 0u);
  answer.found = {found(standing(1), 0)};
  const cv::Mat low = draw_sheet({{answer}}, "one");
  const Place left = middle_of(low, kLeftInk), right = middle_of(low, kRightInk);
  ASSERT_GT(left.count, 50u);
  ASSERT_GT(right.count, 50u);
  EXPECT_LT(left.x + 20, right.x);
  for (Point3& joint : answer.found.front().person.joints) joint.x += 2, joint.z += 0.2f;
  const cv::Mat high = draw_sheet({{answer}}, "one");
  EXPECT_GT(middle_of(high, kLeftInk).x, left.x + 50);
  EXPECT_LT(middle_of(high, kLeftInk).y, left.y - 5);
}

TEST(Sheet, WhatIsOutsideIsCutOff) {
  Answer answer{0, {}, {standing(1)}, {}, {}, {}};
  answer.found = {found(standing(900), 0)};
  EXPECT_EQ(middle_of(draw_sheet({{answer}}, "far"), kLeftInk).count, 0u);
}

TEST(JointErrors, ABarStandsOverItsErrors) {
  const std::vector<Detection> near(10, found(standing(0), 0.06f)), far(10, found(standing(0), 7));
  const Place of_near = middle_of(draw_joint_errors(near, "near"), kRightInk);
  const Place of_far = middle_of(draw_joint_errors(far, "far"), kRightInk);
  ASSERT_GT(of_near.count, 0u);
  EXPECT_NEAR(of_far.x - of_near.x, 17 * 210 / 20., 1.5) << "from the third bin to the last";
  EXPECT_NEAR(of_far.y, of_near.y, 1.5);
  EXPECT_EQ(middle_of(draw_joint_errors({}, "nobody"), kRightInk).count, 0u);
}

TEST(ErrorByCount, BarsAreAsHighAsTheError) {
  std::vector<NamedMetrics> rows = {{"model", Metrics(Protocol::detect)}};
  Skeleton aside = standing(0);
  for (Point3& joint : aside) joint.y += 0.15f;
  rows[0].detect.add({{aside}}, {{standing(0)}});
  const cv::Mat picture = draw_error_by_count(rows, "model");
  int highest = 0;
  for (int x = 0; x < picture.cols; ++x)
    highest = std::max(highest, static_cast<int>(middle_of(picture.col(x), kLeftInk).count));
  EXPECT_NEAR(highest, 225, 2) << "150 mm of 200 on an axis of 300 pixels";
  EXPECT_FALSE(draw_error_by_count({}, "nothing").empty());
}

}  // namespace
}  // namespace csipose::train
