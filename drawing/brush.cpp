#include "drawing/brush.h"

#include <cmath>
#include <opencv2/imgproc.hpp>

namespace csipose {
namespace {

constexpr int kShift = 4;        // bits of a pixel's fraction
constexpr double kCapital = 21;  // height of a capital letter of that font at scale 1

enum class SideOf { left, right, middle };
SideOf side_of(std::string_view joint) {
  return joint.starts_with("left")    ? SideOf::left
         : joint.starts_with("right") ? SideOf::right
                                      : SideOf::middle;
}
const Ink& ink_of(SideOf side) {
  return side == SideOf::left ? kLeftInk : side == SideOf::right ? kRightInk : kMiddleInk;
}
/// A bone between the sides, or within the trunk's middle, belongs to neither.
const Ink& ink_of_bone(std::size_t a, std::size_t b) {
  const SideOf from = side_of(kJointNames[a]), to = side_of(kJointNames[b]);
  return ink_of(from == SideOf::middle ? to : to == SideOf::middle || from == to ? from : SideOf::middle);
}

}  // namespace

void Brush::line(glm::dvec2 a, glm::dvec2 b, const Ink& ink, double width) {
  cv::line(page_, fixed(a), fixed(b), ink, thickness(width), cv::LINE_AA, kShift);
}
void Brush::dot(glm::dvec2 p, double radius, const Ink& ink) {
  cv::circle(page_, fixed(p), static_cast<int>(radius * unit_px_ * (1 << kShift)), ink, cv::FILLED,
             cv::LINE_AA, kShift);
}
void Brush::box(glm::dvec2 low, glm::dvec2 high, const Ink& ink) {
  cv::rectangle(page_, whole(low), whole(high), ink, cv::FILLED);
}
void Brush::frame(glm::dvec2 low, glm::dvec2 high, const Ink& ink, double width) {
  cv::rectangle(page_, whole(low), whole(high), ink, thickness(width), cv::LINE_AA);
}
void Brush::text(glm::dvec2 at, const std::string& words, double height, const Ink& ink, double weight) {
  cv::putText(page_, words, whole(at), cv::FONT_HERSHEY_SIMPLEX, height * unit_px_ / kCapital, ink,
              thickness(weight), cv::LINE_AA);
}
double Brush::text_width(const std::string& words, double height) const {
  int base = 0;
  return cv::getTextSize(words, cv::FONT_HERSHEY_SIMPLEX, height * unit_px_ / kCapital, 1, &base).width /
         unit_px_;
}

cv::Point Brush::fixed(glm::dvec2 p) const {
  p *= unit_px_ * (1 << kShift);
  return {static_cast<int>(p.x), static_cast<int>(p.y)};
}
cv::Point Brush::whole(glm::dvec2 p) const {
  return {static_cast<int>(std::lround(p.x * unit_px_)), static_cast<int>(std::lround(p.y * unit_px_))};
}
int Brush::thickness(double width) const {
  return std::max(1, static_cast<int>(std::lround(width * unit_px_)));
}

const Ink& ink_of_joint(std::size_t joint) { return ink_of(side_of(kJointNames[joint])); }

void draw_bones(Brush& brush, const DrawnJoints& joints, const Ink& ink, double width) {
  for (const auto& [a, b] : kBones)
    if (joints[a] && joints[b]) brush.line(*joints[a], *joints[b], ink, width);
}

void draw_skeleton(Brush& brush, const DrawnJoints& joints, double size) {
  draw_bones(brush, joints, kWhiteInk, 3.6 * size);
  for (const auto& [a, b] : kBones)
    if (joints[a] && joints[b]) brush.line(*joints[a], *joints[b], ink_of_bone(a, b), 2 * size);
  for (std::size_t j = 0; j < kJoints; ++j) {
    if (!joints[j]) continue;
    brush.dot(*joints[j], 3.5 * size, kWhiteInk);
    brush.dot(*joints[j], 2.5 * size, ink_of_joint(j));
  }
}

}  // namespace csipose
