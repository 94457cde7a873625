// drawing/brush.h - lines, words and skeletons on a page of pixels, in units of the picture whatever the page's pixels are.
#pragma once

#include <array>
#include <glm/vec2.hpp>
#include <opencv2/core/mat.hpp>
#include <optional>
#include <string>

#include "proto/pose.h"

namespace csipose {

using Ink = cv::Scalar;  ///< blue, green, red
inline const Ink kInk(52, 44, 40), kPaleInk(140, 134, 128), kWhiteInk(255, 255, 255),
    kPaperInk(250, 250, 251);
inline const Ink kLeftInk(200, 120, 20), kRightInk(40, 90, 235), kMiddleInk(90, 80, 75);

/// Units run from the page's top left; `unit_px` of them are a pixel. The page must outlive the brush.
class Brush {
 public:
  Brush(cv::Mat& page, double unit_px) : page_(page), unit_px_(unit_px) {}

  void line(glm::dvec2 a, glm::dvec2 b, const Ink& ink, double width);
  void dot(glm::dvec2 p, double radius, const Ink& ink);
  void box(glm::dvec2 low, glm::dvec2 high, const Ink& ink);
  void frame(glm::dvec2 low, glm::dvec2 high, const Ink& ink, double width);
  /// `height`: of capitals. `at`: left end of the base line.
  void text(glm::dvec2 at, const std::string& words, double height, const Ink& ink, double weight = 1);
  double text_width(const std::string& words, double height) const;
  cv::Rect area(glm::dvec2 low, glm::dvec2 high) const { return {whole(low), whole(high)}; }
  cv::Mat& page() { return page_; }
  double unit_px() const { return unit_px_; }

 private:
  cv::Point fixed(glm::dvec2 p) const;
  cv::Point whole(glm::dvec2 p) const;
  int thickness(double width) const;

  cv::Mat& page_;
  double unit_px_;
};

/// Of a joint: left, right or the middle.
const Ink& ink_of_joint(std::size_t joint);

/// Where joints are on the page; nothing for one that cannot be drawn.
using DrawnJoints = std::array<std::optional<glm::dvec2>, kJoints>;
/// Bones and joints by side, with a white edge. `size`: 1 is bones of two units' width.
void draw_skeleton(Brush& brush, const DrawnJoints& joints, double size = 1);
/// Bones alone, in one ink.
void draw_bones(Brush& brush, const DrawnJoints& joints, const Ink& ink, double width);

}  // namespace csipose
