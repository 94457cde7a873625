#include "sim/walk.h"

#include <cmath>

#include "sim/geometry.h"
#include "sim/shadow.h"

namespace csipose::sim {
namespace {
constexpr double kAnyHeight_m = 10;
}  // namespace

Vec3 Course::at(double arc_m) const {
  const double angle = turn_rad_per_m * arc_m;
  // sin(x)/x and (1 - cos x)/x, with their limits where the course is straight
  const double ahead = std::abs(angle) < 1e-6 ? 1 : std::sin(angle) / angle;
  const double aside = std::abs(angle) < 1e-6 ? angle / 2 : (1 - std::cos(angle)) / angle;
  const Vec3 forward{std::cos(heading_rad), std::sin(heading_rad), 0}, left{-forward.y, forward.x, 0};
  return start + arc_m * (ahead * forward + aside * left);
}

Gait::Gait(const Figure& person, double speed) : figure(person), speed_m_s(speed) {
  const double relative = speed / figure.hip_height_m();
  stride_m = 1.346 * std::sqrt(relative) * figure.hip_height_m();
  cycle_s = stride_m / speed;
  stance_fraction = (0.752 * cycle_s - 0.143) / cycle_s;
}

Gait::Foot Gait::foot_at(std::size_t side, double t_s) const {
  const double h = figure.stature_m, lag = side == kLeft ? 0.5 : 0;
  const double phase = t_s / cycle_s + lag, number = std::floor(phase), u = phase - number;
  const double strike_m = (number - lag) * stride_m + 0.21 * stride_m;
  if (u < stance_fraction) {
    const double rise = smooth_step((u / stance_fraction - 0.45) / 0.55);
    return {strike_m + 0.075 * h * rise, figure.ankle_height_m() + 0.07 * h * rise};
  }
  const double w = (u - stance_fraction) / (1 - stance_fraction), s = smooth_step(w);
  const double lifted_m = strike_m + 0.075 * h;
  return {lifted_m + s * (strike_m + stride_m - lifted_m),
          figure.ankle_height_m() + 0.07 * h * (1 - s) + 0.4 * h * w * w * (1 - w) * (1 - w)};
}

Posture walking(const Gait& gait, const Course& course, double t_s) {
  const Figure& figure = gait.figure;
  const double arc_m = gait.speed_m_s * t_s;
  Posture posture;
  posture.pelvis = course.at(arc_m);
  posture.heading_rad = course.heading_at(arc_m);
  for (const std::size_t side : {kLeft, kRight}) {
    const Gait::Foot foot = gait.foot_at(side, t_s);
    const double heading = course.heading_at(foot.arc_m);
    const Vec3 left{-std::sin(heading), std::cos(heading), 0};
    posture.ankles[side] = course.at(foot.arc_m) + sign_of(side) * figure.half_hips_m() * left;
    posture.ankles[side].z = foot.ankle_z_m;
    posture.foot_heading_rad[side] = heading;
    // Arms swing against the leg of their side, which is furthest ahead at its strike.
    const double swing = std::cos(2 * kPi * (t_s / gait.cycle_s + (side == kLeft ? 0.5 : 0)));
    posture.arms[side] = {-(8 + 14 * gait.speed_m_s) * kDegree * swing, 8 * kDegree,
                          (20 - 10 * swing) * kDegree};
  }
  posture.trunk_yaw_rad = 5 * kDegree * std::cos(2 * kPi * t_s / gait.cycle_s);
  posture.pelvis.z = pelvis_height(figure, posture, kAnyHeight_m);
  return posture;
}

}  // namespace csipose::sim
