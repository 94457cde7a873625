#include "daemon/draw.h"

#include <gtest/gtest.h>

#include <opencv2/imgcodecs.hpp>
#include <opencv2/imgproc.hpp>

#include "proto/result.h"
#include "tests/daemon/scratch_folder.h"

namespace csipose {
namespace {

/// 1000 columns: the left half at amplitude 100, the right half 40 dB below; phase pi / 2 throughout.
CsiTrace two_halves() {
  CsiTrace trace;
  trace.name = "test";
  trace.records = 1000;
  for (int t = 0; t < 1000; ++t) {
    Features features;
    features.fill(t < 500 ? 100.0f : 1.0f);
    std::fill(features.begin() + kSubcarriers * kAntennas, features.end(), 1.5707964f);
    trace.columns.push_back(features);
  }
  return trace;
}

cv::Vec3b colour(int grey, int map) {
  cv::Mat one(1, 1, CV_8UC1, cv::Scalar(grey)), coloured;
  cv::applyColorMap(one, coloured, map);
  return coloured.at<cv::Vec3b>(0, 0);
}

TEST(Draw, PutsAmplitudeAndPhaseWhereTheyBelong) {
  const testing::ScratchFolder scratch;
  draw_csi({two_halves()}, (scratch / "a.png"));
  const cv::Mat picture = cv::imread((scratch / "a.png"));
  ASSERT_EQ(picture.cols, 1000 + 2 * 12);
  ASSERT_EQ(picture.rows, 6 * (22 + 120 + 12));
  for (int antenna = 0; antenna < 3; ++antenna) {
    const int middle = antenna * 154 + 22 + 60;
    EXPECT_EQ(picture.at<cv::Vec3b>(middle, 100), colour(255, cv::COLORMAP_VIRIDIS));
    EXPECT_EQ(picture.at<cv::Vec3b>(middle, 900), colour(0, cv::COLORMAP_VIRIDIS));
    EXPECT_EQ(picture.at<cv::Vec3b>(middle + 3 * 154, 300), colour(191, cv::COLORMAP_TWILIGHT));
  }
}

TEST(Draw, RefusesToDrawNothing) {
  const testing::ScratchFolder scratch;
  EXPECT_THROW(draw_csi({}, (scratch / "a.png")), SetupError);
  EXPECT_THROW(draw_csi({two_halves()}, (scratch / "no_such_folder/a.png")), SetupError);
}

}  // namespace
}  // namespace csipose
