// train/evaluation_picture.h - what an evaluation found, as pictures: skeletons beside the true ones, how errors spread over
// joints, and how they grow with the number of people.
//
// 8 bits a channel, blue first, as OpenCV has it. Drawn in the room frame, z up; nothing depends on how good an answer was.
#pragma once

#include <opencv2/core/mat.hpp>
#include <span>
#include <string>
#include <vector>

#include "train/evaluation.h"

namespace csipose::train {

/// `count` of the windows in which somebody is, spread evenly over them, ascending; all when there are fewer.
std::vector<std::size_t> spread_windows(const WindowSource& windows, std::size_t count);

/// A sheet of windows: from the front (along y) and from above, one scale for all. True skeletons are broad and grey, those
/// found coloured by side. At least one answer with somebody in it (assert).
cv::Mat draw_sheet(std::span<const Answer> answers, const std::string& title);

/// A histogram of errors per joint, over the people that `detect` matched; said so where there are none.
cv::Mat draw_joint_errors(std::span<const Detection> detections, const std::string& title);

struct NamedMetrics {
  std::string name;
  Metrics detect;
};
/// Mean error of `detect` by the number of people who are there, a bar for each row and beside it one in which everybody
/// missed counts 500 mm.
cv::Mat draw_error_by_count(std::span<const NamedMetrics> rows, const std::string& title);

}  // namespace csipose::train
