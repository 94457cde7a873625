#include "sim/human.h"

#include <algorithm>
#include <cmath>

namespace csipose::sim {
namespace {
constexpr double kTrunk = 0.315;  // pelvis to neck, of the stature

/// Along a to b, third column; the first as near to `side` as it can be.
Mat3 axes_along(const Vec3& along, const Vec3& side) {
  const Vec3 z = glm::normalize(along);
  const Vec3 x = glm::normalize(side - glm::dot(side, z) * z);
  return {x, glm::cross(z, x), z};
}

Vec3 across_part(const Vec3& v, const Vec3& axis) {
  const Vec3 part = v - glm::dot(v, axis) * axis;
  const double length = glm::length(part);
  return length > 1e-9 ? part / length : Vec3{0};
}

Vec3 turned(const Vec3& v, const Vec3& axis, double angle) {  // Rodrigues
  return std::cos(angle) * v + std::sin(angle) * glm::cross(axis, v) +
         (1 - std::cos(angle)) * glm::dot(axis, v) * axis;
}

void set_trunk(const Figure& figure, const Posture& posture, Stance& s) {
  const Vec3 up{0, 0, 1};
  s.pelvis = posture.pelvis;
  s.pelvis_forward = {std::cos(posture.heading_rad), std::sin(posture.heading_rad), 0};
  s.pelvis_left = glm::cross(up, s.pelvis_forward);
  s.pelvis_left = turned(s.pelvis_left, s.pelvis_forward, -posture.pelvis_roll_rad);
  s.forward = turned(s.pelvis_forward, up, posture.trunk_yaw_rad);
  s.left = glm::cross(up, s.forward);
  s.up = turned(up, s.left, posture.trunk_pitch_rad);
  s.forward = turned(s.forward, s.left, posture.trunk_pitch_rad);
  s.up = turned(s.up, s.forward, -posture.trunk_roll_rad);
  s.left = glm::cross(s.up, s.forward);
  s.head_up = s.up;
  s.neck = s.pelvis + kTrunk * figure.stature_m * s.up;
}

/// The foot's direction: level when flat; the toes stay low when the ankle rises.
Vec3 toes_of(const Figure& figure, const Posture& posture, std::size_t side) {
  const double raised = (posture.ankles[side].z - figure.ankle_height_m()) / (0.12 * figure.stature_m);
  const double sine = std::clamp(raised, 0.0, 0.8), cosine = std::sqrt(1 - sine * sine);
  const double heading = posture.foot_heading_rad[side];
  return {cosine * std::cos(heading), cosine * std::sin(heading), -sine};
}

void set_arm(const Figure& figure, const ArmAngles& arm, std::size_t side, Stance& s) {
  const double sign = sign_of(side);
  const Vec3 upper = std::sin(arm.flexion) * std::cos(arm.abduction) * s.forward +
                     sign * std::sin(arm.abduction) * s.left -
                     std::cos(arm.flexion) * std::cos(arm.abduction) * s.up;
  // A hanging arm bends forward, one stretched ahead or aside upward, a raised one backward; all between is smooth.
  const double out = glm::dot(upper, s.forward) + sign * glm::dot(upper, s.left);
  const Vec3 bend = across_part(out * s.up - glm::dot(upper, s.up) * s.forward, upper);
  const Vec3 fore = std::cos(arm.elbow) * upper + std::sin(arm.elbow) * bend;
  s.shoulders[side] = s.pelvis + 0.288 * figure.stature_m * s.up + sign * figure.half_shoulders_m() * s.left;
  s.elbows[side] = s.shoulders[side] + figure.upper_arm_m(side) * upper;
  s.wrists[side] = s.elbows[side] + figure.forearm_m(side) * fore;
  s.hands[side] = s.wrists[side] + 0.054 * figure.stature_m * fore;
}

}  // namespace

Vec3 knee_of(const Figure& figure, std::size_t side, const Vec3& hip, const Vec3& ankle, const Vec3& forward,
             const Vec3& left, double splay_rad) {
  const double l1 = figure.thigh_m(side), l2 = figure.shank_m(side);
  const double d = std::min(glm::distance(hip, ankle), 0.998 * (l1 + l2));
  const Vec3 down = glm::normalize(ankle - hip);
  const double cosine = std::clamp((l1 * l1 + d * d - l2 * l2) / (2 * l1 * d), -1.0, 1.0);
  // Forward across the leg, and what lies in front of it when it is swung up: the same for one who stands.
  const Vec3 front = forward - glm::dot(forward, down) * down + glm::cross(down, left);
  const Vec3 bend = turned(across_part(front, down), down, -sign_of(side) * splay_rad);
  return hip + l1 * cosine * down + l1 * std::sqrt(1 - cosine * cosine) * bend;
}

double pelvis_height(const Figure& figure, const Posture& posture, double lower_m) {
  constexpr double kBlend_m = 0.015;
  const Vec3 left{-std::sin(posture.heading_rad), std::cos(posture.heading_rad), 0};
  double sum = std::exp(-0.985 * figure.hip_height_m() / kBlend_m) + std::exp(-lower_m / kBlend_m);
  for (const std::size_t side : {kLeft, kRight}) {
    const Vec3 hip = posture.pelvis + sign_of(side) * figure.half_hips_m() * left;
    const Vec3 off = posture.ankles[side] - hip;
    const double reach = 0.993 * (figure.thigh_m(side) + figure.shank_m(side));
    const double drop2 = reach * reach - off.x * off.x - off.y * off.y;
    sum += std::exp(-(posture.ankles[side].z + std::sqrt(std::max(drop2, 0.0))) / kBlend_m);
  }
  return -kBlend_m * std::log(sum);
}

Stance stance_of(const Figure& figure, const Posture& posture) {
  Stance s;
  set_trunk(figure, posture, s);
  for (const std::size_t side : {kLeft, kRight}) {
    s.hips[side] = s.pelvis + sign_of(side) * figure.half_hips_m() * s.pelvis_left;
    s.ankles[side] = posture.ankles[side];
    s.knees[side] = knee_of(figure, side, s.hips[side], s.ankles[side], s.pelvis_forward, s.pelvis_left,
                            posture.knees_out_rad);
    s.toes[side] = toes_of(figure, posture, side);
    set_arm(figure, posture.arms[side], side, s);
  }
  return s;
}

std::array<Vec3, kJoints> joints_of(const Figure& figure, const Stance& s) {
  const double h = figure.stature_m;
  const auto hand = [&](std::size_t side) {
    return s.wrists[side] + 0.026 * h * glm::normalize(s.hands[side] - s.wrists[side]);
  };
  return {s.neck,
          s.neck + 0.047 * h * s.head_up,
          s.shoulders[kLeft],
          s.shoulders[kRight],
          s.elbows[kLeft],
          s.hips[kLeft],
          s.elbows[kRight],
          s.hips[kRight],
          hand(kLeft),
          s.knees[kLeft],
          hand(kRight),
          s.knees[kRight],
          s.ankles[kLeft],
          s.ankles[kRight]};
}

std::vector<Body> bodies_of(const Figure& figure, const Stance& s, const Surface& skin) {
  const double h = figure.stature_m;
  std::vector<Body> bodies;
  const auto add = [&](const Vec3& centre, const Vec3& along, const Vec3& side, const Vec3& half) {
    const Vec3 grown{half.x * figure.girth, half.y * figure.girth, half.z};
    bodies.push_back({Shape::ellipsoid, centre, axes_along(along, side), h * grown, skin});
  };
  // `half_length` as a share of the bone
  const auto add_limb = [&](const Vec3& from, const Vec3& to, double half_width, double half_length) {
    const Vec3 side = std::abs(glm::dot(glm::normalize(to - from), s.left)) < 0.9 ? s.left : s.up;
    add((from + to) / 2.0, to - from, side,
        {half_width, half_width, half_length * glm::distance(from, to) / h});
  };
  const double trunk = glm::distance(s.pelvis, s.neck) / (kTrunk * h);
  add(s.neck + 0.085 * h * s.head_up, s.head_up, s.left, {0.0445, 0.056, 0.065});
  add(s.neck + 0.010 * h * s.up, s.up, s.left, {0.034, 0.034, 0.035});
  add(s.pelvis + 0.19 * h * trunk * s.up, s.up, s.left, {0.095, 0.065, 0.115 * trunk});
  bodies.back().half_m += Vec3{s.breath_m, s.breath_m, 0};
  add(s.pelvis + 0.035 * h * trunk * s.up, s.up, s.pelvis_left, {0.093, 0.065, 0.095 * trunk});
  for (const std::size_t side : {kLeft, kRight}) {
    add_limb(s.shoulders[side], s.elbows[side], 0.029, 0.098 / 0.186);
    add_limb(s.elbows[side], s.wrists[side], 0.024, 0.075 / 0.146);
    add(s.hands[side], s.hands[side] - s.wrists[side], s.forward, {0.024, 0.012, 0.054});
    add_limb(s.hips[side], s.knees[side], 0.049, 0.132 / 0.245);
    add_limb(s.knees[side], s.ankles[side], 0.033, 0.125 / 0.246);
    // The foot points ahead from below the ankle.
    const Vec3 sole_left = glm::normalize(glm::cross(Vec3{0, 0, 1}, s.toes[side]));
    add(s.ankles[side] + 0.045 * h * s.toes[side] - 0.019 * h * glm::cross(s.toes[side], sole_left),
        s.toes[side], sole_left, {0.027, 0.020, 0.076});
  }
  return bodies;
}

}  // namespace csipose::sim
