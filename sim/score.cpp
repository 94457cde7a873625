#include "sim/score.h"

#include <algorithm>
#include <cmath>

#include "sim/geometry.h"
#include "sim/shadow.h"

namespace csipose::sim {
namespace {

/// Integral of smooth_step() from 0 to x; x - 1/2 beyond 1.
double smooth_step_area(double x) {
  if (x <= 0) return 0;
  if (x >= 1) return x - 0.5;
  const double x2 = x * x;
  return x2 * x2 * (2.5 - 3 * x + x2);
}

/// The last of `notes` that has begun by t, or the first.
template <class Notes, class Begin>
const auto& begun_by(const Notes& notes, double t_s, const Begin& begin) {
  const auto after = std::upper_bound(notes.begin(), notes.end(), t_s,
                                      [&](double t, const auto& note) { return t < begin(note); });
  return after == notes.begin() ? notes.front() : *std::prev(after);
}

Vec3 ahead(double heading_rad) { return {std::cos(heading_rad), std::sin(heading_rad), 0}; }
Vec3 leftward(double heading_rad) { return {-std::sin(heading_rad), std::cos(heading_rad), 0}; }

}  // namespace

double Curve::at(double t_s) const {
  const auto after = std::upper_bound(notes_.begin() + 1, notes_.end(), t_s,
                                      [](double t, const Note& note) { return t < note.begin_s; });
  const Note& note = *std::prev(after);
  if (after - notes_.begin() == 1) return note.value;
  const double from = std::prev(after, 2)->value;
  return from + (note.value - from) * smooth_step((t_s - note.begin_s) / (note.end_s - note.begin_s));
}

double Swing::at(double t_s) const {
  if (t_s <= begin_s || t_s >= end_s) return 0;
  const double swell = smooth_step((t_s - begin_s) / swell_s) * smooth_step((end_s - t_s) / swell_s);
  return amplitude * swell * std::sin(2 * kPi * rate_hz * (t_s - begin_s));
}

double Travel::arc_m(double t_s) const {
  if (length_m == 0) return 0;
  const double up = (t_s - begin_s) / ramp_s, down = (t_s - (end_s - ramp_s)) / ramp_s;
  return std::min(length_m, cruise_m_s * ramp_s * (smooth_step_area(up) - smooth_step_area(down)));
}

double Travel::heading_at(double t_s) const {
  const double turned = turn_rad == 0 ? 0 : turn_rad * smooth_step((t_s - begin_s) / (end_s - begin_s));
  return course.heading_at(arc_m(t_s)) + turned;
}

double Travel::speed_at(double t_s) const {
  if (length_m == 0) return 0;
  return cruise_m_s *
         (smooth_step((t_s - begin_s) / ramp_s) - smooth_step((t_s - (end_s - ramp_s)) / ramp_s));
}

FootTrack::State FootTrack::at(double t_s, double stature_m) const {
  const auto after = std::upper_bound(steps_.begin(), steps_.end(), t_s,
                                      [](double t, const Step& step) { return t < step.roll_s; });
  if (after == steps_.begin()) return {start_, start_heading_rad_, true};
  const Step& step = *std::prev(after);
  if (t_s >= step.strike_s) return {step.to, step.heading_rad, true};
  const bool first = std::prev(after) == steps_.begin();
  const Vec3 from = first ? start_ : std::prev(after, 2)->to;
  const double from_heading = first ? start_heading_rad_ : std::prev(after, 2)->heading_rad;
  // Ankle over the toes, then through the air: the same shapes as Gait::foot_at().
  const double rise = step.roll * smooth_step((t_s - step.roll_s) / (step.lift_s - step.roll_s));
  const Vec3 rolled = from + 0.075 * stature_m * rise * ahead(from_heading);
  const double w = std::max(0.0, (t_s - step.lift_s) / (step.strike_s - step.lift_s)), s = smooth_step(w);
  State state{rolled + s * (step.to - rolled), from_heading + s * (step.heading_rad - from_heading), false};
  const double arch = std::max(step.roll, 0.3) * 0.4 * w * w * (1 - w) * (1 - w);
  state.ankle.z = from.z + s * (step.to.z - from.z) + stature_m * (0.07 * rise * (1 - s) + arch);
  return state;
}

Score::Score(const Figure& person, const Vec3& place, double heading_rad)
    : figure(person), hips_m(person.hip_height_m()) {
  Travel standing;
  standing.begin_s = standing.end_s = kLongAgo_s;
  standing.course.start = {place.x, place.y, 0};
  standing.course.heading_rad = heading_rad;
  travels.push_back(standing);
  for (const std::size_t side : {kLeft, kRight}) {
    Vec3 ankle = standing.course.start + sign_of(side) * figure.half_hips_m() * leftward(heading_rad);
    ankle.z = figure.ankle_height_m();
    feet[side] = FootTrack(ankle, heading_rad);
  }
}

Vec3 Score::place() const { return travels.back().course.at(travels.back().length_m); }
double Score::heading_rad() const {
  const Travel& last = travels.back();
  return last.course.heading_at(last.length_m) + last.turn_rad;
}

const Travel& Score::travel_at(double t_s) const {
  return begun_by(travels, t_s, [](const Travel& travel) { return travel.begin_s; });
}

Score::Lean Score::lean_at(double t_s) const {
  if (!topple) return {0, hips_m.at(t_s)};
  constexpr double kAlmostStraight = 0.985;
  const double leg_m = kAlmostStraight * std::min(figure.thigh_m(kLeft) + figure.shank_m(kLeft),
                                                  figure.thigh_m(kRight) + figure.shank_m(kRight));
  // On a side the hips pass from beside each other to one above the other: the legs reach less far.
  const double reach_m = leg_m - 1.2 * std::abs(topple->left) * figure.half_hips_m();
  const double lying = std::acos((topple->low_m - figure.ankle_height_m()) / reach_m);
  const double angle = lying * smooth_step((t_s - topple->begin_s) / (topple->end_s - topple->begin_s));
  return {reach_m * std::sin(angle),
          std::min(hips_m.at(t_s), figure.ankle_height_m() + reach_m * std::cos(angle))};
}

Posture Score::at(double t_s) const {
  const Travel& travel = travel_at(t_s);
  Posture posture;
  posture.heading_rad = travel.heading_at(t_s);
  const Vec3 forward = ahead(posture.heading_rad), left = leftward(posture.heading_rad);
  const Vec3 place = travel.course.at(travel.arc_m(t_s));
  posture.pelvis = place - back_m.at(t_s) * forward;
  const Lean lean = lean_at(t_s);
  if (topple) posture.pelvis += lean.out_m * (topple->ahead * forward + topple->left * left);
  // Arms swing against the leg of their side, the shoulders against the hips.
  const double stride_m = travel.length_m > 0 ? Gait(figure, travel.cruise_m_s).stride_m : 1;
  const double swing_rad = travel.length_m > 0 ? (8 + 14 * travel.cruise_m_s) * kDegree : 0;
  std::array<double, 2> reach{};
  for (const std::size_t side : {kLeft, kRight}) {
    const FootTrack::State foot = feet[side].at(t_s, figure.stature_m);
    posture.ankles[side] = foot.ankle;
    posture.foot_heading_rad[side] = foot.heading_rad;
    reach[side] = glm::dot(foot.ankle - place, forward) / (0.25 * stride_m);
    const Arm& arm = arms[side];
    double elbow = arm.elbow_rad.at(t_s);
    for (const Swing& wave : arm.waves) elbow += wave.at(t_s);
    posture.arms[side] = {arm.flexion_rad.at(t_s) - swing_rad * reach[side], arm.abduction_rad.at(t_s),
                          elbow};
  }
  posture.trunk_pitch_rad = pitch_rad.at(t_s);
  posture.trunk_roll_rad = roll_rad.at(t_s);
  posture.pelvis_roll_rad = pelvis_roll_rad.at(t_s);
  posture.knees_out_rad = knees_out_rad.at(t_s);
  posture.trunk_yaw_rad = yaw_rad.at(t_s);
  if (travel.length_m > 0) posture.trunk_yaw_rad += 2.5 * kDegree * (reach[kRight] - reach[kLeft]);
  posture.pelvis.z = pelvis_height(figure, posture, lean.hips_m);
  return posture;
}

}  // namespace csipose::sim
