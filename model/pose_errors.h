// model/pose_errors.h - how far one predicted pose is from a person's, and how that person stands.
//
// In the coordinates of the label, millimetres.
// Source: cseeyangchen/DT-Pose (PCK); Horn 1987 (alignment); Moon et al., ICCV 2019 (MRPE, errors as seen from the root).
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <string_view>

#include "proto/pose.h"

namespace csipose {

/// Share of joints within a distance, percent. torso: times right shoulder to left hip; elbows: times elbow
/// to elbow (what DT-Pose's code measures on this data set); mm: as it stands.
struct PoseErrors {
  double mpjpe = 0;              ///< mean distance of joints, mm
  std::array<double, 3> axis{};  ///< mean absolute difference, mm
  double mrpe = 0;               ///< distance of the roots, mm: where somebody is
  double root_mpjpe = 0;         ///< mean distance of joints, each seen from its own root, mm: how he stands
  double pa_mpjpe = 0;           ///< mm, after the similarity that fits best
  /// Angle between the two left_to_right(); 90 where one has no length, as for a guess on average.
  double facing_deg = 0;
  double breadth_mm = 0;        ///< how much longer the predicted left_to_right() is; far below 0: a stick
  double pck20 = 0, pck50 = 0;  ///< torso
  double pck20_elbows = 0, pck50_elbows = 0;
  double pck20mm = 0, pck50mm = 0;
};
/// One prediction against one person.
PoseErrors pose_errors(const Skeleton& predicted, const Skeleton& person);
/// Distance of each joint, mm.
std::array<double, kJoints> joint_errors_mm(const Skeleton& predicted, const Skeleton& person);
/// `predicted` turned (never mirrored), scaled and moved so that the squared distances to `person` are least;
/// only moved when all its joints are one point.
Skeleton aligned(const Skeleton& predicted, const Skeleton& person);

/// How somebody stands, told by the joints alone, in whatever frame; the first that fits.
enum class Posture : std::uint8_t {
  low,          ///< hips nearer to the ankles than 0.8 of the legs' length: sitting, squatting
  bent,         ///< from hips to neck leans by more than 40 degrees from the line from ankles to hips
  arms_raised,  ///< a hand is further along that trunk than the neck
  upright
};
inline constexpr std::size_t kPostures = 4;
std::string_view name_of(Posture posture);
Posture posture_of(const Skeleton& person);

}  // namespace csipose
