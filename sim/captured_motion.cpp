#include "sim/captured_motion.h"

#include <fmt/core.h>

#include <algorithm>
#include <cmath>

#include "proto/result.h"

namespace csipose::sim {
namespace {
constexpr double kLeastStature_m = 0.8, kMostStature_m = 2.4;
constexpr double kLeastBone_m = 0.04;
constexpr double kUprightOfStature =
    0.25;  // whoever sits on the floor has the neck 0.28 of the stature above the ankles
constexpr double kLegOfStature = 0.245 + 0.246, kArmOfStature = 0.186 + 0.146,
                 kTrunkOfStature = 0.315;  // human.h
/// Landmarks that are not at one place.
constexpr std::array<std::array<std::size_t, 2>, 12> kApartMarks{{{kShoulderMark, kShoulderMark + 1},
                                                                  {kHipMark, kHipMark + 1},
                                                                  {kNeckMark, kHipMark},
                                                                  {kNeckMark, kHipMark + 1},
                                                                  {kShoulderMark, kElbowMark},
                                                                  {kShoulderMark + 1, kElbowMark + 1},
                                                                  {kElbowMark, kWristMark},
                                                                  {kElbowMark + 1, kWristMark + 1},
                                                                  {kHipMark, kKneeMark},
                                                                  {kHipMark + 1, kKneeMark + 1},
                                                                  {kKneeMark, kAnkleMark},
                                                                  {kKneeMark + 1, kAnkleMark + 1}}};
constexpr std::size_t kLeftFoot = 9, kRightFoot = 15;  // in bodies_of()

Vec3 unit_or(const Vec3& v, const Vec3& otherwise) {
  const double length = glm::length(v);
  return length > 1e-6 ? v / length : otherwise;
}

Vec3 across(const Vec3& v, const Vec3& axis) { return v - glm::dot(v, axis) * axis; }

/// y up, z ahead, x left (or z up, x ahead) to x ahead, y left, z up.
glm::dquat upright(bool z_up) {
  return z_up ? glm::dquat(1, 0, 0, 0) : glm::dquat(0.5, 0.5, 0.5, 0.5);  // x -> y -> z -> x
}

glm::dquat about_z(double angle_rad) { return glm::angleAxis(angle_rad, Vec3{0, 0, 1}); }

/// Which joints of a file matter, and where each of them points.
class Family {
 public:
  explicit Family(const BvhClip& clip) : joints_(clip.joints), reach_(clip.joints.size(), 0.0) {
    for (std::size_t j = joints_.size(); j-- > 1;)
      reach_[parent(j)] = std::max(reach_[parent(j)], reach_[j] + glm::length(joints_[j].offset));
  }
  std::size_t parent(std::size_t j) const { return static_cast<std::size_t>(joints_[j].parent); }
  bool is_above(std::size_t ancestor, std::size_t j) const {
    while (j > ancestor) j = parent(j);  // parents come first
    return j == ancestor;
  }
  /// The first joint away from j on the longest chain below it: knuckle, crown.
  std::optional<std::size_t> tip(std::size_t j) const {
    const std::size_t from = j;
    for (Vec3 way{0}; glm::length(way) <= 1e-3 * reach_[from]; way += joints_[j].offset) {
      const auto next = longest_child(j);
      if (!next) return std::nullopt;
      j = *next;
    }
    return j == from ? std::nullopt : std::optional(j);
  }

  /// The last one: the tip of the toes.
  std::optional<std::size_t> end(std::size_t j) const {
    std::optional<std::size_t> last;
    for (auto next = longest_child(j); next; next = longest_child(*next)) last = next;
    return last;
  }

 private:
  std::optional<std::size_t> longest_child(std::size_t j) const {
    std::optional<std::size_t> best;
    const auto length = [&](std::size_t c) { return reach_[c] + glm::length(joints_[c].offset); };
    for (std::size_t c = j + 1; c < joints_.size(); ++c)
      if (parent(c) == j && (!best || length(c) > length(*best))) best = c;
    return best;
  }

  const std::vector<BvhClip::Joint>& joints_;
  std::vector<double> reach_;  ///< length of the longest chain below
};

[[noreturn]] void refuse(const BvhClip& clip, const std::string& why) {
  throw SetupError(ExitStatus::bad_data, fmt::format("{}: {}", clip.file_name, why));
}

}  // namespace

struct CapturedMotion::Pose {
  std::array<Vec3, kMostBvhJoints> place;
  std::array<glm::dquat, kMostBvhJoints> turn;
};

CapturedMotion::CapturedMotion(const BvhClip& clip, const Landmarks& landmarks, const Part& part,
                               CounterRng rng)
    : frame_s_(clip.frame_s), upright_(upright(part.z_up.value_or(landmarks.naming->z_up))) {
  const double unit_m = part.metres_per_unit.value_or(landmarks.naming->metres_per_unit);
  room_from_file_ = upright_;
  add_nodes(clip, landmarks, unit_m);
  read_frames(clip, part, unit_m);
  measure(clip, landmarks, unit_m);
  figure_.girth = draw_girth(rng);
  breath_ = draw_breath(rng);
  if (!part.z_up) expect_upright(clip);
  find_soles(clip);
  stand_on_floor();
  put({0, 0, 0}, 0);
}

void CapturedMotion::add_nodes(const BvhClip& clip, const Landmarks& landmarks, double metres_per_unit) {
  const Family family(clip);
  std::array<std::optional<std::size_t>, 5> tips{
      family.tip(landmarks.joint[kHeadMark]), family.tip(landmarks.joint[kWristMark + kLeft]),
      family.tip(landmarks.joint[kWristMark + kRight]), family.end(landmarks.joint[kAnkleMark + kLeft]),
      family.end(landmarks.joint[kAnkleMark + kRight])};
  std::vector<std::size_t> node_of(clip.joints.size(), kNone);
  for (std::size_t j = 0; j < clip.joints.size(); ++j) {
    const auto matters = [&](std::size_t goal) { return family.is_above(j, goal); };
    const bool needed =
        std::any_of(landmarks.joint.begin(), landmarks.joint.end(), matters) ||
        std::any_of(tips.begin(), tips.end(), [&](const auto& tip) { return tip && matters(*tip); });
    if (!needed) continue;
    // Bones are as long as the tree says; only what carries all of the body may travel.
    const BvhClip::Joint& joint = clip.joints[j];
    const bool carries_all = std::all_of(landmarks.joint.begin(), landmarks.joint.end(), matters);
    const std::size_t parent = joint.parent < 0 ? kNone : node_of[static_cast<std::size_t>(joint.parent)];
    node_of[j] = nodes_.size();
    nodes_.push_back({parent, metres_per_unit * joint.offset, carries_all ? movers_++ : kNone,
                      joint.channels.empty() ? kNone : turners_++});
    source_.push_back(j);
  }
  for (std::size_t mark = 0; mark < kLandmarks; ++mark) marks_[mark] = node_of[landmarks.joint[mark]];
  const auto tip_node = [&](std::size_t i) { return tips[i] ? node_of[*tips[i]] : kNone; };
  crown_ = tip_node(0);
  fingers_ = {tip_node(1), tip_node(2)};
  toes_ = {tip_node(3), tip_node(4)};
}

void CapturedMotion::read_frames(const BvhClip& clip, const Part& part, double metres_per_unit) {
  const double whole_s = frame_s_ * static_cast<double>(clip.frames() - 1);
  if (!(part.from_s >= 0 && part.from_s <= whole_s && part.seconds >= 0))
    refuse(clip,
           fmt::format("goes from 0 to {:.3f} s; there is no part of it at {} s", whole_s, part.from_s));
  const auto frame_at = [&](double t_s) {
    return std::min(clip.frames() - 1, static_cast<std::size_t>(std::min(t_s, whole_s) / frame_s_ + 0.5));
  };
  const std::size_t first = frame_at(part.from_s), last = frame_at(part.from_s + part.seconds);
  frames_ = last + 1 - first;
  for (std::size_t frame = first; frame <= last; ++frame)
    for (std::size_t n = 0; n < nodes_.size(); ++n) {
      if (nodes_[n].mover != kNone) places_.push_back(metres_per_unit * clip.position(frame, source_[n]));
      if (nodes_[n].turner != kNone) turns_.push_back(clip.rotation(frame, source_[n]));
    }
}

void CapturedMotion::pose_at(double t_s, Pose& pose) const {
  const double last = static_cast<double>(frames_ - 1), at = std::clamp(t_s / frame_s_, 0.0, last);
  const std::size_t from = std::min(static_cast<std::size_t>(at), frames_ - 1),
                    to = std::min(from + 1, frames_ - 1);
  const double w = at - static_cast<double>(from);
  for (std::size_t n = 0; n < nodes_.size(); ++n) {
    const Node& node = nodes_[n];
    Vec3 step_m = node.offset_m;
    if (node.mover != kNone)
      step_m = glm::mix(places_[from * movers_ + node.mover], places_[to * movers_ + node.mover], w);
    glm::dquat turn(1, 0, 0, 0);
    if (node.turner != kNone)
      turn = glm::slerp(turns_[from * turners_ + node.turner], turns_[to * turners_ + node.turner], w);
    const bool is_root = node.parent == kNone;
    const glm::dquat& base = is_root ? room_from_file_ : pose.turn[node.parent];
    pose.place[n] = (is_root ? shift_m_ : pose.place[node.parent]) + base * step_m;
    pose.turn[n] = base * turn;
  }
}

Vec3 CapturedMotion::aim(const Pose& pose, std::size_t from, std::size_t at, const Vec3& otherwise) const {
  return at == kNone ? otherwise : unit_or(pose.place[at] - pose.place[from], otherwise);
}

Stance CapturedMotion::stance_of(const Pose& pose) const {
  Stance s;
  const auto mark = [&](std::size_t landmark) { return pose.place[marks_[landmark]]; };
  for (const std::size_t side : {kLeft, kRight}) {
    s.shoulders[side] = mark(kShoulderMark + side);
    s.elbows[side] = mark(kElbowMark + side);
    s.wrists[side] = mark(kWristMark + side);
    s.hips[side] = mark(kHipMark + side);
    s.knees[side] = mark(kKneeMark + side);
    s.ankles[side] = mark(kAnkleMark + side);
    const Vec3 fore = unit_or(s.wrists[side] - s.elbows[side], {0, 0, -1});
    s.hands[side] = s.wrists[side] +
                    0.054 * figure_.stature_m * aim(pose, marks_[kWristMark + side], fingers_[side], fore);
    s.toes[side] = pose.turn[marks_[kAnkleMark + side]] * soles_[side];
  }
  s.neck = mark(kNeckMark);
  s.pelvis = (s.hips[kLeft] + s.hips[kRight]) / 2.0;
  s.up = unit_or(s.neck - s.pelvis, {0, 0, 1});
  s.pelvis_left = unit_or(s.hips[kLeft] - s.hips[kRight], {0, 1, 0});
  s.pelvis_forward = unit_or(glm::cross(s.pelvis_left, s.up), {1, 0, 0});
  s.left =
      unit_or(across(s.shoulders[kLeft] - s.shoulders[kRight], s.up), glm::cross(s.up, s.pelvis_forward));
  s.forward = glm::cross(s.left, s.up);
  s.head_up = aim(pose, marks_[kNeckMark], crown_ == kNone ? marks_[kHeadMark] : crown_, s.up);
  return s;
}

Stance CapturedMotion::at(double t_s) const {
  Pose pose;
  pose_at(t_s, pose);
  Stance stance = stance_of(pose);
  stance.breath_m = breath_.amplitude_m + breath_.at(t_s);
  return stance;
}

void CapturedMotion::measure(const BvhClip& clip, const Landmarks& landmarks, double metres_per_unit) {
  Pose pose;
  pose_at(0, pose);
  const auto length_m = [&](std::size_t a, std::size_t b) {
    return glm::distance(pose.place[marks_[a]], pose.place[marks_[b]]);
  };
  std::array<double, 2> legs{}, arms{};
  for (const std::size_t side : {kLeft, kRight}) {
    legs[side] = length_m(kHipMark + side, kKneeMark + side) + length_m(kKneeMark + side, kAnkleMark + side);
    arms[side] =
        length_m(kShoulderMark + side, kElbowMark + side) + length_m(kElbowMark + side, kWristMark + side);
  }
  const double trunk_m = glm::distance(
      (pose.place[marks_[kHipMark]] + pose.place[marks_[kHipMark + 1]]) / 2.0, pose.place[marks_[kNeckMark]]);
  const double stature_m = ((legs[kLeft] + legs[kRight]) / 2 + trunk_m) / (kLegOfStature + kTrunkOfStature);
  if (stature_m < kLeastStature_m || stature_m > kMostStature_m)
    refuse(clip, fmt::format(
                     "whoever has these legs and this trunk is {:.3g} m tall at {} m per unit; give another "
                     "unit of length with --bvh-unit (1 for metres, 0.0254 for inches)",
                     stature_m, metres_per_unit));
  for (const auto& [a, b] : kApartMarks)
    if (length_m(a, b) < kLeastBone_m)
      refuse(clip, fmt::format("lines {} and {}: {} and {} are {:.3f} m apart; are they the right joints?",
                               clip.joints[landmarks.joint[a]].line, clip.joints[landmarks.joint[b]].line,
                               kLandmarkNames[a], kLandmarkNames[b], length_m(a, b)));
  figure_ = Figure(stature_m);
  for (const std::size_t side : {kLeft, kRight}) {
    figure_.legs[side] = legs[side] / (kLegOfStature * stature_m);
    figure_.arms[side] = arms[side] / (kArmOfStature * stature_m);
  }
}

void CapturedMotion::expect_upright(const BvhClip& clip) const {
  Pose pose;
  double highest_m = -1e300;  // of the neck above the ankles
  for (std::size_t frame = 0; frame < frames_; ++frame) {
    pose_at(time_of(frame), pose);
    const Vec3 ankles = (pose.place[marks_[kAnkleMark]] + pose.place[marks_[kAnkleMark + 1]]) / 2.0;
    highest_m = std::max(highest_m, pose.place[marks_[kNeckMark]].z - ankles.z);
  }
  if (highest_m < kUprightOfStature * figure_.stature_m)
    refuse(clip,
           fmt::format("nobody stands or sits up in it: the neck is at most {:.2f} m above the ankles. Say "
                       "--bvh-up z if that axis points up, or --bvh-up y if it is so",
                       highest_m));
}

void CapturedMotion::find_soles(const BvhClip& clip) {
  Pose pose;
  std::array<double, 2> lowest_m{1e300, 1e300};
  double ahead_m = 0;
  for (std::size_t frame = 0; frame < frames_; ++frame) {
    pose_at(time_of(frame), pose);
    const Vec3 forward = stance_of(pose).pelvis_forward;
    for (const std::size_t side : {kLeft, kRight}) {
      const std::size_t ankle = marks_[kAnkleMark + side], toe = toes_[side] == kNone ? ankle : toes_[side];
      const Vec3 foot = pose.place[toe] - pose.place[ankle];
      ahead_m += glm::dot(foot, forward);
      const double height_m = pose.place[ankle].z + pose.place[toe].z;
      if (height_m >= lowest_m[side]) continue;
      lowest_m[side] = height_m;
      const Vec3 level = unit_or({forward.x, forward.y, 0}, {1, 0, 0});
      soles_[side] = glm::conjugate(pose.turn[ankle]) * unit_or({foot.x, foot.y, 0}, level);
    }
  }
  if (ahead_m < 0)
    refuse(clip,
           "the feet point backward; are left and right exchanged in the table of joints, or is 'up' wrong?");
}

void CapturedMotion::stand_on_floor() {
  Pose pose;
  floor_m_ = 1e300;
  for (std::size_t frame = 0; frame < frames_; ++frame) {
    pose_at(time_of(frame), pose);
    const std::vector<Body> bodies = bodies_of(figure_, stance_of(pose), {});
    for (const std::size_t foot : {kLeftFoot, kRightFoot})
      floor_m_ = std::min(floor_m_, bodies[foot].centre.z - bodies[foot].support_m({0, 0, 1}));
  }
}

Rectangle CapturedMotion::way() const {
  Rectangle way{1e300, 1e300, -1e300, -1e300};
  for (std::size_t frame = 0; frame < frames_; ++frame) {
    const Vec3 p = at(time_of(frame)).pelvis;
    way = {std::min(way.x0, p.x), std::min(way.y0, p.y), std::max(way.x1, p.x), std::max(way.y1, p.y)};
  }
  return way;
}

void CapturedMotion::put(const Vec3& middle, double turn_rad) {
  room_from_file_ = about_z(turn_rad) * upright_;
  shift_m_ = {0, 0, -floor_m_};
  const Rectangle now = way();
  shift_m_.x = middle.x - (now.x0 + now.x1) / 2;
  shift_m_.y = middle.y - (now.y0 + now.y1) / 2;
}

}  // namespace csipose::sim
