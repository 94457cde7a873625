#include "train/profile.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>

#include "proto/pose_geometry.h"
#include "proto/window.h"

namespace csipose::train {
namespace {

/// Means over the published set's training labels.
/// source: model.md of the specification, section 15.
struct PublishedLength {
  std::size_t joint, other;
  double mean_m;
};
constexpr PublishedLength kPublished[] = {
    {kNeck, kHead, .079},
    {kLeftShoulder, kRightShoulder, .322},
    {kLeftShoulder, kLeftElbow, .269},
    {kLeftElbow, kLeftHand, .293},
    {kLeftHip, kRightHip, .169},
    {kRightShoulder, kLeftHip, .523},
    {kRightKnee, kRightAnkle, .370},
};

constexpr float kBent_m = 0.05f;
/// A share of n people as near to one half as this tells nothing: three standard deviations, and never less than 0.1.
double undecided(std::size_t n) { return std::max(0.1, 1.5 / std::sqrt(static_cast<double>(n))); }

/// How far the knee stands out from the middle of hip and ankle.
Point3 knee_out(const Skeleton& p, Joint hip, Joint knee, Joint ankle) {
  return {p[knee].x - (p[hip].x + p[ankle].x) / 2, p[knee].y - (p[hip].y + p[ankle].y) / 2, 0};
}

std::string bone_line(std::size_t a, std::size_t b, double mean_m, double published_m) {
  const std::string name = fmt::format("{} - {}", kJointNames[a], kJointNames[b]);
  const std::string published = published_m > 0 ? fmt::format("{:.3f}", published_m) : "-";
  return fmt::format("  {:32}{:8.3f}{:>11}\n", name, mean_m, published);
}

double published_m(std::size_t a, std::size_t b) {
  for (const PublishedLength& length : kPublished)
    if (length.joint == a && length.other == b) return length.mean_m;
  return 0;
}

double share(std::size_t part, std::size_t whole) {
  return whole == 0 ? std::nan("") : static_cast<double>(part) / static_cast<double>(whole);
}

}  // namespace

std::string Profile::group_of(const LabelledWindow& window) const {
  if (about_.kind == "published") return fmt::format("scene {}", scene_of_clip(window.clip));
  return window.room ? about_.room_name(*window.room) : "all";
}

void Profile::add(const LabelledWindow& window) {
  ProfileGroup& group = groups_[group_of(window)];
  ++group.windows;
  ++group.by_people[window.people.size()];
  for (std::size_t l = 0; l < kLinks; ++l) {
    double sum = 0;
    for (std::size_t k = 0; k < kSubcarriers; ++k)
      for (std::size_t t = 0; t < kSamples; ++t) sum += static_cast<double>(window.x[Window::index(k, t, l)]);
    group.amplitude_sum[l] += sum / (kSubcarriers * kSamples);
  }
  for (const Skeleton& person : window.people) add_person(person);
}

void Profile::add_person(const Skeleton& person) {
  ++people_;
  for (std::size_t a = 0; a < kJoints; ++a)
    for (std::size_t b = 0; b < kJoints; ++b) length_sum_m_[a][b] += distance_m(person[a], person[b]);
  neck_over_ankles_m_ +=
      static_cast<double>(person[kNeck].z - (person[kLeftAnkle].z + person[kRightAnkle].z) / 2);

  // left . (up x forward) with up = (0, 0, 1): turning axis 2 over changes neither of the level coordinates.
  const Point3 one = knee_out(person, kLeftHip, kLeftKnee, kLeftAnkle);
  const Point3 other = knee_out(person, kRightHip, kRightKnee, kRightAnkle);
  const float forward_x = one.x + other.x, forward_y = one.y + other.y;
  const float left_x = person[kLeftShoulder].x - person[kRightShoulder].x;
  const float left_y = person[kLeftShoulder].y - person[kRightShoulder].y;
  const bool left = left_y * forward_x - left_x * forward_y > 0;
  const bool bent = std::hypot(forward_x, forward_y) >= kBent_m;
  left_ += left;
  bent_ += bent;
  left_of_bent_ += left && bent;
}

double Profile::mean_length_m(std::size_t joint, std::size_t other) const {
  return people_ == 0 ? std::nan("") : length_sum_m_[joint][other] / static_cast<double>(people_);
}

LabelAxes Profile::axes() const {
  return {neck_over_ankles_m_ < 0 ? -1. : 1., people_, share(left_, people_), bent_,
          share(left_of_bent_, bent_)};
}

std::string Profile::describe_groups() const {
  std::size_t most = 0;
  for (const auto& [name, group] : groups_) most = std::max(most, group.by_people.rbegin()->first);
  std::string text = fmt::format("{:16}{:>9}", "windows", "all");
  if (about_.labelled)
    for (std::size_t p = 0; p <= most; ++p) text += fmt::format("{:>8}", fmt::format("{}P", p));
  for (const auto& [name, group] : groups_) {
    text += fmt::format("\n  {:14}{:9}", name, group.windows);
    if (!about_.labelled) continue;
    for (std::size_t p = 0; p <= most; ++p)
      text += fmt::format("{:8}", group.by_people.contains(p) ? group.by_people.at(p) : 0);
  }
  text += fmt::format("\n{:16}", "mean amplitude");
  for (std::size_t l = 0; l < kLinks; ++l)
    text += fmt::format("{:>8}", fmt::format("rx{}.{}", l / kAntennas + 1, "ABC"[l % kAntennas]));
  for (const auto& [name, group] : groups_) {
    text += fmt::format("\n  {:14}", name);
    for (std::size_t l = 0; l < kLinks; ++l) text += fmt::format("{:8.2f}", group.mean_amplitude(l));
  }
  return text + "\n";
}

std::string Profile::describe_bones() const {
  std::string text =
      fmt::format("{:34}{:>8}{:>11}\n", fmt::format("lengths of {} people, m", people_), "mean", "published");
  for (const auto& [a, b] : kBones) text += bone_line(a, b, mean_length_m(a, b), published_m(a, b));
  for (const auto& [a, b] : {std::pair<std::size_t, std::size_t>(2, 3), {3, 5}})
    text += bone_line(a, b, mean_length_m(a, b), published_m(a, b));
  return text;
}

std::string Profile::describe_axes() const {
  const LabelAxes found = axes();
  const bool up = found.up > 0;
  std::string text = fmt::format(
      "axes\n  axis 2 points {}: necks are {:.2f} m {} along it than ankles\n", up ? "up" : "down",
      std::abs(neck_over_ankles_m_) / static_cast<double>(people_), up ? "further" : "less far");
  text += fmt::format("  left . (up x forward) is positive for {:.1f} % of people", 100 * found.left);
  if (found.bent > 0)
    text += fmt::format(", {:.1f} % of the {} whose knees stand out by 5 cm", 100 * found.left_of_bent,
                        found.bent);
  const bool by_bent = found.bent > 0;
  const double decisive = by_bent ? found.left_of_bent : found.left;
  if (std::abs(decisive - 0.5) < undecided(by_bent ? found.bent : found.people))
    return text + "\n  which tells nothing: left may be right\n";
  return text + fmt::format("\n  so label to room is diag(1, {}, {}){}\n", decisive > 0.5 ? "1" : "-1",
                            up ? "1" : "-1",
                            decisive > 0.5 ? "" : ": with axis 2 up, axes 0 and 1 are mirrored");
}

std::string Profile::describe() const {
  std::string text = describe_groups();
  if (people_ > 0) text += describe_bones() + describe_axes();
  if (!about_.labelled) text += "no labels: nothing to say of people\n";
  return text;
}

}  // namespace csipose::train
