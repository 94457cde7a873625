// sim/human.h - a person: segments, posture, the sixteen ellipsoids that waves meet, and the fourteen labelled joints.
//
// Segment lengths as fractions of stature: Drillis and Contini (1966) as tabulated by Winter, Biomechanics and Motor Control
// of Human Movement. Girths were chosen for a body mass index of 22.5.
#pragma once

#include <array>
#include <vector>

#include "proto/shape.h"
#include "sim/body.h"

namespace csipose::sim {

/// Lengths in metres of one person.
struct Figure {
  explicit Figure(double stature) : stature_m(stature) {}
  double stature_m;
  double girth = 1;  ///< factor on all widths: sqrt(BMI / 22.5)
  std::array<double, 2> legs{1, 1},
      arms{1, 1};  ///< factor on the lengths of either side; nobody is quite symmetric

  double thigh_m(std::size_t side = 0) const { return 0.245 * stature_m * legs[side]; }
  double shank_m(std::size_t side = 0) const { return 0.246 * stature_m * legs[side]; }
  double upper_arm_m(std::size_t side) const { return 0.186 * stature_m * arms[side]; }
  double forearm_m(std::size_t side) const { return 0.146 * stature_m * arms[side]; }
  double ankle_height_m() const { return 0.039 * stature_m; }
  double hip_height_m() const { return 0.530 * stature_m; }
  double half_hips_m() const { return 0.052 * stature_m; }
  double half_shoulders_m() const { return 0.095 * stature_m; }
};

enum Side : std::size_t { kLeft = 0, kRight = 1 };
/// +1 left, -1 right, along the body's left.
inline double sign_of(std::size_t side) { return side == kLeft ? 1 : -1; }

/// Angles of one arm, radians.
struct ArmAngles {
  double flexion = 0;    ///< upper arm: 0 hangs down, pi/2 forward, pi up
  double abduction = 0;  ///< away from the body
  double elbow = 0;      ///< 0 straight
};

/// How a person stands at one instant: what motion decides.
struct Posture {
  Vec3 pelvis{};           ///< middle of the hips
  double heading_rad = 0;  ///< about z; 0 looks along +x
  double trunk_pitch_rad = 0, trunk_roll_rad = 0,
         trunk_yaw_rad = 0;  ///< forward, to the left, against the pelvis
  double pelvis_roll_rad =
      0;  ///< of the hips alone, to the left: who lies on a side has them above each other
  std::array<Vec3, 2> ankles{};
  std::array<double, 2> foot_heading_rad{};
  double knees_out_rad =
      0;  ///< both knees turned outward: who lies face down has them beside the legs, not below
  std::array<ArmAngles, 2> arms{};
};

/// The same as points, room frame.
struct Stance {
  Vec3 pelvis{}, neck{}, forward{}, left{}, up{};  ///< forward, left, up: the trunk's axes
  Vec3 pelvis_forward{}, pelvis_left{};
  Vec3 head_up{};              ///< unit, from the neck to the crown
  std::array<Vec3, 2> toes{};  ///< unit, from the heel
  double breath_m = 0;         ///< by which the thorax is wider and deeper than at rest
  std::array<Vec3, 2> hips{}, knees{}, ankles{}, shoulders{}, elbows{}, wrists{}, hands{};
};
Stance stance_of(const Figure& figure, const Posture& posture);

/// The knee between hip and ankle: it bends forward, that of one who lies on the back upward. `forward` and `left` are the
/// pelvis's; `splay_rad` turns the knee outward. An ankle out of reach is drawn in to 0.998 of the leg.
Vec3 knee_of(const Figure& figure, std::size_t side, const Vec3& hip, const Vec3& ankle, const Vec3& forward,
             const Vec3& left, double splay_rad);

/// As high as both legs reach and no higher than `lower_m`, rounded off over 15 mm: a soft minimum. Of `posture` it takes the
/// pelvis's place on the floor, the heading and the ankles.
double pelvis_height(const Figure& figure, const Posture& posture, double lower_m);

/// Labels in the order of proto/pose.h. They are where the real data set puts them: "head" and "hand" lie nearer than the
/// middles of skull and fist.
std::array<Vec3, kJoints> joints_of(const Figure& figure, const Stance& stance);

/// Their widths follow the stature, their lengths the bones of the stance.
/// Head, neck, thorax, pelvis, and upper arm, forearm, hand, thigh, shank, foot of either side.
std::vector<Body> bodies_of(const Figure& figure, const Stance& stance, const Surface& skin);

}  // namespace csipose::sim
