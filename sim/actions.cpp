#include "sim/actions.h"

#include <algorithm>
#include <cassert>
#include <cmath>

#include "sim/geometry.h"

namespace csipose::sim {
namespace {
constexpr double kPeakOfStep = 1.875;      // of a minimum-jerk step: largest slope over mean slope
constexpr double kMostAcceleration = 1.0;  // m/s^2
constexpr double kSlowCadence_m_s = 0.5;   // nobody steps slower than one who walks at this speed

double near(CounterRng& rng, double usual) { return usual * rng.uniform(0.8, 1.2); }

double last_quiet(const Score& score) {
  return std::max(score.feet[kLeft].quiet_after_s(), score.feet[kRight].quiet_after_s());
}

Vec3 ankle_beside(const Figure& figure, Vec3 place, double heading_rad, std::size_t side) {
  place += sign_of(side) * figure.half_hips_m() * Vec3{-std::sin(heading_rad), std::cos(heading_rad), 0};
  place.z = figure.ankle_height_m();
  return place;
}

/// When walking at changing speed, how far through the cycle of steps: 1 = two steps.
class Cadence {
 public:
  Cadence(const Figure& figure, const Travel& travel) : figure_(figure), travel_(travel) {}
  double cycle_s(double t_s) const {
    return Gait(figure_, std::max(travel_.speed_at(t_s), kSlowCadence_m_s)).cycle_s;
  }
  /// Moves on to the instant at which the phase is `phase`; calls must ask for rising phases.
  double when(double phase) {
    while (phase_ < phase) {
      const double step = kStep_s / cycle_s(t_s_ + kStep_s / 2);
      if (phase_ + step >= phase) return t_s_ + kStep_s * (phase - phase_) / step;
      phase_ += step;
      t_s_ += kStep_s;
    }
    return t_s_;
  }
  void start(double t_s, double phase) { t_s_ = t_s, phase_ = phase; }

 private:
  static constexpr double kStep_s = 1e-3;
  const Figure& figure_;
  const Travel& travel_;
  double t_s_ = 0, phase_ = 0;
};

/// Steps of both feet along a travel until both stand at its end. The foot strikes as far ahead of the hips as in steady
/// walking at the speed of the coming half cycle, so steps shorten where the walker slows down.
void add_steps(Score& score, const Travel& travel, std::size_t first_side) {
  constexpr double kFirstLiftAfter = 0.15;  // of a cycle
  const Figure& figure = score.figure;
  const double usual_step_m = Gait(figure, travel.cruise_m_s).stride_m / 2;
  Cadence cadence(figure, travel);
  const double stance = Gait(figure, travel.cruise_m_s).stance_fraction;
  cadence.start(travel.begin_s, stance - kFirstLiftAfter);
  std::array<double, 2> at_m{};                                  // along the course
  std::array<double, 2> down_s{travel.begin_s, travel.begin_s};  // since when flat
  std::size_t side = first_side;
  for (int strike = 0; at_m[kLeft] < travel.length_m || at_m[kRight] < travel.length_m; ++strike) {
    const double strike_s = cadence.when(1 + 0.5 * strike);
    const double cycle_s = cadence.cycle_s(strike_s);
    const double lead_m = 0.42 * (travel.arc_m(strike_s + cycle_s / 2) - travel.arc_m(strike_s));
    double to_m = std::min(travel.length_m, travel.arc_m(strike_s) + lead_m);
    if (to_m > travel.length_m - 0.02) to_m = travel.length_m;  // the last step is a whole one
    const double lift_s = std::max(down_s[side] + 0.02, strike_s - (1 - stance) * cycle_s);
    const double roll_s = std::max(down_s[side], lift_s - 0.55 * stance * cycle_s);
    const double heading = travel.course.heading_at(to_m);
    const double roll = std::clamp((to_m - at_m[side]) / (2 * usual_step_m), 0.0, 1.0);
    score.feet[side].add({roll_s, lift_s, strike_s,
                          ankle_beside(figure, travel.course.at(to_m), heading, side), heading, roll});
    at_m[side] = to_m;
    down_s[side] = strike_s;
    side = 1 - side;
  }
}

/// All curves that a bending of the body moves: down, hold, back to standing.
struct Bow {
  double hips_m, back_m, pitch_rad, flexion_rad, elbow_rad;
};
void bow_down(Score& score, double begin_s, double end_s, const Bow& bow) {
  score.hips_m.move(begin_s, end_s, bow.hips_m);
  score.back_m.move(begin_s, end_s, bow.back_m);
  score.pitch_rad.move(begin_s, end_s, bow.pitch_rad);
  for (Score::Arm& arm : score.arms) {
    arm.flexion_rad.move(begin_s, end_s, bow.flexion_rad);
    arm.elbow_rad.move(begin_s, end_s, bow.elbow_rad);
  }
}
/// The hips at their height when standing: a curve that ends there moves nothing while it is above.
Bow upright(const Score& score) { return {score.figure.hip_height_m(), 0, 0, 0, Score::kRestElbow_rad}; }

enum class Arms : std::uint8_t { left, right, both };
Arms draw_arms(CounterRng& rng) { return static_cast<Arms>(rng.index(3)); }
bool uses(Arms arms, std::size_t side) {
  return arms == Arms::both || (arms == Arms::left) == (side == kLeft);
}

}  // namespace

std::optional<Action> find_action(std::string_view name) {
  const auto found = std::find(kActionNames.begin(), kActionNames.end(), name);
  if (found == kActionNames.end()) return std::nullopt;
  return static_cast<Action>(found - kActionNames.begin());
}

double add_walk(Score& score, double begin_s, const Vec3& goal, CounterRng& rng) {
  const Vec3 from = score.place();
  Vec3 way = goal - from;
  way.z = 0;
  const double bearing = std::atan2(way.y, way.x);
  double off = std::remainder(bearing - score.heading_rad(), 2 * kPi);
  if (std::abs(off) > kPi / 3) {  // too far round for a bow: turn to it first
    begin_s = add_turn(score, begin_s, off, rng);
    off = 0;
  }
  Travel travel;
  travel.course.start = from;
  travel.course.heading_rad = score.heading_rad();
  // The circle that begins along the heading and meets the goal: the chord turns by half of what the arc turns.
  const double chord_m = glm::length(way);
  travel.course.turn_rad_per_m = std::abs(off) < 1e-9 ? 0 : 2 * std::sin(off) / chord_m;
  travel.length_m = std::abs(off) < 1e-9 ? chord_m : chord_m * off / std::sin(off);
  const double turns = std::abs(travel.course.turn_rad_per_m);
  double speed =
      std::min(rng.uniform(0.4, 1.3), std::sqrt(0.9 * kMostAcceleration * travel.length_m / kPeakOfStep));
  if (turns > 0) speed = std::min(speed, kPi / 2 / turns);  // 90 degrees a second
  travel.cruise_m_s = std::max(0.3, speed);
  travel.ramp_s =
      std::min(kPeakOfStep * travel.cruise_m_s / kMostAcceleration, travel.length_m / travel.cruise_m_s);
  travel.begin_s = begin_s;
  travel.end_s = begin_s + travel.length_m / travel.cruise_m_s + travel.ramp_s;
  score.travels.push_back(travel);
  add_steps(score, travel, rng.index(2));
  return std::max(travel.end_s, last_quiet(score)) + 0.1;
}

double add_turn(Score& score, double begin_s, double turn_rad, CounterRng& rng) {
  const double each = near(rng, 37.5 * kDegree);
  const int pairs = std::max(1, static_cast<int>(std::ceil(std::abs(turn_rad) / each)));
  const double step_s = near(rng, 0.45);  // of one foot
  Travel travel;
  travel.course.start = score.place();
  travel.course.heading_rad = score.heading_rad();
  travel.turn_rad = turn_rad;
  travel.begin_s = begin_s;
  travel.end_s = begin_s + 2 * pairs * step_s;
  score.travels.push_back(travel);
  // The foot on the inner side opens, the other follows.
  const std::size_t opening = turn_rad > 0 ? kLeft : kRight;
  for (int pair = 0; pair < pairs; ++pair)
    for (const std::size_t follows : {std::size_t{0}, std::size_t{1}}) {
      const std::size_t side = follows == 0 ? opening : 1 - opening;
      const double lift_s = begin_s + (2 * pair + static_cast<double>(follows)) * step_s + 0.05;
      const double heading = travel.course.heading_rad + turn_rad * (pair + 1) / pairs;
      score.feet[side].add({lift_s - 0.04, lift_s, lift_s + step_s - 0.06,
                            ankle_beside(score.figure, travel.course.start, heading, side), heading, 0.1});
    }
  return std::max(travel.end_s, last_quiet(score)) + 0.05;
}

double add_raise_arms(Score& score, double begin_s, CounterRng& rng) {
  const Arms which = draw_arms(rng);
  const bool aside = rng.chance(0.5);
  const double angle = rng.uniform(150, 178) * kDegree, up_s = rng.uniform(0.6, 1.2),
               hold_s = rng.uniform(0.3, 1.0), down_s = rng.uniform(0.6, 1.2);
  const double top_s = begin_s + up_s, leave_s = top_s + hold_s, end_s = leave_s + down_s;
  for (const std::size_t side : {kLeft, kRight}) {
    if (!uses(which, side)) continue;
    Score::Arm& arm = score.arms[side];
    Curve& raised = aside ? arm.abduction_rad : arm.flexion_rad;
    const double rest = raised.last();
    raised.move(begin_s, top_s, angle);
    raised.move(leave_s, end_s, rest);
    arm.elbow_rad.move(begin_s, top_s, 0.1);
    arm.elbow_rad.move(leave_s, end_s, Score::kRestElbow_rad);
  }
  return end_s;
}

double add_wave(Score& score, double begin_s, CounterRng& rng) {
  const std::size_t side = rng.index(2);
  const double abduction = rng.uniform(60, 110) * kDegree, elbow = rng.uniform(60, 115) * kDegree,
               amplitude = rng.uniform(20, 33) * kDegree, rate_hz = rng.uniform(1, 2),
               raise_s = near(rng, 0.8), wave_s = rng.uniform(1.5, 3.5);
  Score::Arm& arm = score.arms[side];
  const double up_s = begin_s + raise_s, leave_s = up_s + wave_s, end_s = leave_s + raise_s;
  arm.abduction_rad.move(begin_s, up_s, abduction);
  arm.elbow_rad.move(begin_s, up_s, elbow);
  arm.waves.push_back({up_s, leave_s, 0.4, amplitude, rate_hz});
  arm.abduction_rad.move(leave_s, end_s, Score::kRestAbduction_rad);
  arm.elbow_rad.move(leave_s, end_s, Score::kRestElbow_rad);
  return end_s;
}

double add_stretch(Score& score, double begin_s, CounterRng& rng) {
  const double raise = rng.uniform(165, 178) * kDegree, up_s = near(rng, 1.2), hold_s = rng.uniform(2, 4),
               down_s = near(rng, 1.2);
  const bool sideways = rng.chance(0.6);
  const double roll = rng.uniform(10, 25) * kDegree * (rng.chance(0.5) ? 1 : -1),
               back = -rng.uniform(10, 20) * kDegree;
  const double top_s = begin_s + up_s, leave_s = top_s + hold_s, end_s = leave_s + down_s;
  for (Score::Arm& arm : score.arms) {
    arm.flexion_rad.move(begin_s, top_s, raise);
    arm.elbow_rad.move(begin_s, top_s, 0.1);
    arm.flexion_rad.move(leave_s, end_s, 0);
    arm.elbow_rad.move(leave_s, end_s, Score::kRestElbow_rad);
  }
  Curve& lean = sideways ? score.roll_rad : score.pitch_rad;
  lean.move(top_s, top_s + 0.45 * hold_s, sideways ? roll : back);
  lean.move(top_s + 0.55 * hold_s, leave_s, 0);
  return end_s;
}

double add_bend(Score& score, double begin_s, CounterRng& rng) {
  const double pitch = rng.uniform(60, 100) * kDegree,
               back = rng.uniform(0.05, 0.09) * score.figure.stature_m, down_s = rng.uniform(0.8, 1.6),
               hold_s = rng.uniform(0.3, 1.5), up_s = rng.uniform(0.8, 1.6);
  const double low_s = begin_s + down_s, leave_s = low_s + hold_s, end_s = leave_s + up_s;
  bow_down(score, begin_s, low_s, {score.figure.hip_height_m(), back, pitch, pitch, 0.1});
  bow_down(score, leave_s, end_s, upright(score));
  return end_s;
}

double add_squat(Score& score, double begin_s, CounterRng& rng) {
  const double h = score.figure.stature_m;
  const int times = 1 + static_cast<int>(rng.index(3));
  for (int i = 0; i < times; ++i) {
    const double pitch = rng.uniform(25, 45) * kDegree;
    const Bow low{rng.uniform(0.30, 0.36) * h, rng.uniform(0.08, 0.12) * h, pitch,
                  pitch + rng.uniform(60, 90) * kDegree, 0.15};  // arms ahead in the room
    const double low_s = begin_s + rng.uniform(0.8, 1.5), leave_s = low_s + near(rng, 0.3),
                 end_s = leave_s + rng.uniform(0.8, 1.5);
    bow_down(score, begin_s, low_s, low);
    bow_down(score, leave_s, end_s, upright(score));
    begin_s = end_s + 0.1;
  }
  return begin_s;
}

double add_sit(Score& score, double begin_s, CounterRng& rng) {
  const double h = score.figure.stature_m;
  const double seated_m = kSeat_m + 0.05 * h, back = rng.uniform(0.14, 0.18) * h,
               peak = rng.uniform(35, 50) * kDegree, rest = rng.uniform(0, 10) * kDegree;
  const double down_s = near(rng, 1.4), sit_s = rng.uniform(1, 4), up_s = near(rng, 1.4);
  const double low_s = begin_s + down_s, leave_s = low_s + 0.5 + sit_s, end_s = leave_s + up_s;
  score.hips_m.move(begin_s, low_s, seated_m);
  score.back_m.move(begin_s, low_s, back);
  score.pitch_rad.move(begin_s, begin_s + 0.6 * down_s, peak);
  score.pitch_rad.move(begin_s + 0.75 * down_s, low_s + 0.5, rest);
  for (Score::Arm& arm : score.arms) {  // hands towards the knees
    arm.flexion_rad.move(begin_s, low_s, 35 * kDegree);
    arm.elbow_rad.move(begin_s, low_s, 50 * kDegree);
    arm.flexion_rad.move(leave_s, end_s, 0);
    arm.elbow_rad.move(leave_s, end_s, Score::kRestElbow_rad);
  }
  score.pitch_rad.move(leave_s - 0.3, leave_s + 0.3 * up_s, peak);
  score.pitch_rad.move(leave_s + 0.4 * up_s, end_s, 0);
  score.hips_m.move(leave_s, end_s, score.figure.hip_height_m());
  score.back_m.move(leave_s, end_s, 0);
  return end_s;
}

double add_stand(Score&, double begin_s, CounterRng& rng) { return begin_s + rng.uniform(1, 4); }

double add_fall(Score& score, double begin_s, CounterRng& rng) {
  const double h = score.figure.stature_m, fall_s = rng.uniform(0.6, 1.0),
               lean = rng.uniform(80, 86) * kDegree;
  const double low_s = begin_s + fall_s;
  const std::uint32_t way = rng.index(4);  // forward, backward, left, right
  const double sign = way % 2 == 0 ? 1 : -1;
  const bool on_side = way >= 2;
  score.topple = {begin_s, low_s, 0.12 * h, on_side ? 0 : sign, on_side ? sign : 0};
  if (on_side) {
    score.roll_rad.move(begin_s, low_s, sign * lean);
    score.pelvis_roll_rad.move(begin_s, low_s, sign * lean);
  } else {
    score.pitch_rad.move(begin_s, low_s, sign * lean);
    if (sign > 0) score.knees_out_rad.move(begin_s, begin_s + 0.5 * fall_s, kPi / 3);
  }
  for (Score::Arm& arm : score.arms) {
    const double spread = rng.uniform(50, 85) * kDegree;
    // Whoever lies on a side has the arms ahead of the body: the lower one has no other place.
    arm.flexion_rad.move(begin_s, low_s, on_side ? spread : 0);
    arm.abduction_rad.move(begin_s, low_s, on_side ? 0 : spread);
  }
  return low_s + rng.uniform(2, 4);
}

double add_in_place(Score& score, Action action, double begin_s, CounterRng& rng) {
  switch (action) {
    case Action::raise_arms:
      return add_raise_arms(score, begin_s, rng);
    case Action::wave:
      return add_wave(score, begin_s, rng);
    case Action::stretch:
      return add_stretch(score, begin_s, rng);
    case Action::bend:
      return add_bend(score, begin_s, rng);
    case Action::squat:
      return add_squat(score, begin_s, rng);
    case Action::sit:
      return add_sit(score, begin_s, rng);
    case Action::stand:
      return add_stand(score, begin_s, rng);
    case Action::fall:
      return add_fall(score, begin_s, rng);
    case Action::walk:
    case Action::turn:
      break;
  }
  assert(false);
  return begin_s;
}

}  // namespace csipose::sim
