// sim/score.h - a person's movements written down beforehand, so that any instant can be read off on its own.
//
// What a person does is laid out in time as a musician's score is: where the hips travel, where and when each foot steps, and
// curves for trunk, arms and the height of the hips. Everything between two notes is a minimum-jerk step (Flash and Hogan,
// J. Neuroscience 5 (1985) 1688), so positions, speeds and accelerations are continuous.
#pragma once

#include <array>
#include <optional>
#include <vector>

#include "sim/walk.h"

namespace csipose::sim {

/// Before any note. Notes may have negative times.
inline constexpr double kLongAgo_s = -1e9;

/// A number over time: holds its last value until the next note, and reaches that one by a minimum-jerk step.
class Curve {
 public:
  explicit Curve(double start = 0) : notes_{{kLongAgo_s, kLongAgo_s, start}} {}
  /// From `begin` to `end` the value goes to `value`. Notes come in order and do not overlap.
  void move(double begin_s, double end_s, double value) { notes_.push_back({begin_s, end_s, value}); }
  double at(double t_s) const;
  double last() const { return notes_.back().value; }

 private:
  struct Note {
    double begin_s, end_s, value;
  };
  std::vector<Note> notes_;
};

/// A swing about a curve's value that swells and dies away: waving.
struct Swing {
  double begin_s, end_s, swell_s, amplitude, rate_hz;
  double at(double t_s) const;
};

/// One stretch of the hips' way over the floor: along a course, turning, or both.
struct Travel {
  double begin_s = 0, end_s = 0;
  Course course;
  double length_m = 0, ramp_s = 1;  ///< of the course; speeding up and slowing down take ramp_s each
  double turn_rad = 0;              ///< on the spot, left positive
  double cruise_m_s = 0;            ///< between the ramps

  /// Way along the course; 0 before, length_m after.
  double arc_m(double t_s) const;
  double heading_at(double t_s) const;
  double speed_at(double t_s) const;
};

/// One foot's way: flat on the floor, rolling over the toes, swinging, flat again.
class FootTrack {
 public:
  struct Step {
    double roll_s, lift_s, strike_s;  ///< when the heel rises, the foot leaves the floor, and is flat again
    Vec3 to{};                        ///< ankle
    double heading_rad = 0;
    double roll = 1;  ///< how far it rolls before it leaves, 1 = as in a full stride
  };
  FootTrack() = default;
  FootTrack(const Vec3& ankle, double heading_rad) : start_{ankle}, start_heading_rad_(heading_rad) {}
  void add(const Step& step) { steps_.push_back(step); }
  const Vec3& end() const { return steps_.empty() ? start_ : steps_.back().to; }
  /// When the last step is down.
  double quiet_after_s() const { return steps_.empty() ? kLongAgo_s : steps_.back().strike_s; }

  struct State {
    Vec3 ankle{};
    double heading_rad = 0;
    bool flat = true;  ///< and hence fixed
  };
  State at(double t_s, double stature_m) const;

 private:
  Vec3 start_{};
  double start_heading_rad_ = 0;
  std::vector<Step> steps_;
};

/// Everything of one person.
struct Score {
  Score(const Figure& figure, const Vec3& place, double heading_rad);

  Figure figure;
  std::vector<Travel> travels;  ///< in order; the first stands at the start
  std::array<FootTrack, 2> feet;
  Curve hips_m;  ///< height that the hips go down to; where the legs do not reach it they decide
  Curve back_m;  ///< hips behind where the travel has them
  Curve pitch_rad, roll_rad, yaw_rad, pelvis_roll_rad, knees_out_rad;
  struct Arm {
    Curve flexion_rad, abduction_rad{kRestAbduction_rad}, elbow_rad{kRestElbow_rad};
    std::vector<Swing> waves;  ///< of the elbow
  };
  std::array<Arm, 2> arms;

  /// The hips go over like a pole that stands on the feet, on legs that stay almost straight, down to `low_m`.
  struct Topple {
    double begin_s, end_s, low_m;
    double ahead, left;  ///< direction, of length 1
  };
  std::optional<Topple> topple;

  static constexpr double kRestAbduction_rad = 0.14, kRestElbow_rad = 0.26;

  /// Where the travel ends so far.
  Vec3 place() const;
  double heading_rad() const;
  /// t anywhere; before the first note and after the last the person stands as there.
  Posture at(double t_s) const;

 private:
  const Travel& travel_at(double t_s) const;
  struct Lean {
    double out_m, hips_m;  ///< over the feet; height that the hips go down to
  };
  Lean lean_at(double t_s) const;
};

}  // namespace csipose::sim
