#include "model/pose_errors.h"

#include <algorithm>
#include <cmath>
#include <numbers>

#include "proto/pose_geometry.h"

namespace csipose {
namespace {

constexpr double kLowLegs = 0.8;       // hips to ankles, of the legs' length
constexpr double kBentTrunk_deg = 40;  // from the line from ankles to hips

using Vector = std::array<double, 3>;
using Matrix4 = std::array<std::array<double, 4>, 4>;

Vector vector_of(const Point3& p) {
  return {static_cast<double>(p.x), static_cast<double>(p.y), static_cast<double>(p.z)};
}
Vector minus(const Vector& a, const Vector& b) { return {a[0] - b[0], a[1] - b[1], a[2] - b[2]}; }
double dot(const Vector& a, const Vector& b) { return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]; }
double length(const Vector& v) { return std::sqrt(dot(v, v)); }
Vector centre(const Skeleton& pose) {
  Vector sum{};
  for (const Point3& joint : pose)
    for (std::size_t k = 0; k < 3; ++k) sum[k] += vector_of(joint)[k] / kJoints;
  return sum;
}

/// Turns the symmetric matrix by one Jacobi rotation so that [p][q] becomes 0; `vectors` collects them.
void jacobi(Matrix4& m, Matrix4& vectors, std::size_t p, std::size_t q) {
  if (m[p][q] == 0) return;
  const double theta = (m[q][q] - m[p][p]) / (2 * m[p][q]);
  const double t = (theta >= 0 ? 1. : -1.) / (std::abs(theta) + std::sqrt(theta * theta + 1));
  const double c = 1 / std::sqrt(t * t + 1), s = t * c;
  for (std::size_t k = 0; k < 4; ++k) {
    const double kp = m[k][p], kq = m[k][q];
    m[k][p] = c * kp - s * kq, m[k][q] = s * kp + c * kq;
  }
  for (std::size_t k = 0; k < 4; ++k) {
    const double pk = m[p][k], qk = m[q][k];
    m[p][k] = c * pk - s * qk, m[q][k] = s * pk + c * qk;
    const double vp = vectors[k][p], vq = vectors[k][q];
    vectors[k][p] = c * vp - s * vq, vectors[k][q] = s * vp + c * vq;
  }
}

struct Turn {
  std::array<double, 4> quaternion;
  double gain;  ///< sum over joints of person . R predicted
};

/// Horn's quaternion: eigenvector of the greatest eigenvalue of a matrix made of the sums S[i][j] of
/// predicted_i person_j. It is a rotation by construction, never a mirror.
Turn best_turn(const std::array<Vector, 3>& s) {
  Matrix4 n = {{{s[0][0] + s[1][1] + s[2][2], s[1][2] - s[2][1], s[2][0] - s[0][2], s[0][1] - s[1][0]},
                {0, s[0][0] - s[1][1] - s[2][2], s[0][1] + s[1][0], s[2][0] + s[0][2]},
                {0, 0, s[1][1] - s[0][0] - s[2][2], s[1][2] + s[2][1]},
                {0, 0, 0, s[2][2] - s[0][0] - s[1][1]}}};
  Matrix4 vectors{};
  for (std::size_t i = 0; i < 4; ++i) {
    vectors[i][i] = 1;
    for (std::size_t k = 0; k < i; ++k) n[i][k] = n[k][i];
  }
  for (int sweep = 0; sweep < 30; ++sweep)
    for (std::size_t p = 0; p < 3; ++p)
      for (std::size_t q = p + 1; q < 4; ++q) jacobi(n, vectors, p, q);
  std::size_t best = 0;
  for (std::size_t i = 1; i < 4; ++i)
    if (n[i][i] > n[best][best]) best = i;
  return {{vectors[0][best], vectors[1][best], vectors[2][best], vectors[3][best]}, n[best][best]};
}

Vector turned(const std::array<double, 4>& quaternion, const Vector& v) {
  const auto [w, x, y, z] = quaternion;
  return {(w * w + x * x - y * y - z * z) * v[0] + 2 * (x * y - w * z) * v[1] + 2 * (x * z + w * y) * v[2],
          2 * (x * y + w * z) * v[0] + (w * w - x * x + y * y - z * z) * v[1] + 2 * (y * z - w * x) * v[2],
          2 * (x * z - w * y) * v[0] + 2 * (y * z + w * x) * v[1] + (w * w - x * x - y * y + z * z) * v[2]};
}

double angle_deg(const Vector& a, const Vector& b) {
  const double lengths = length(a) * length(b);
  return lengths > 0 ? std::acos(std::clamp(dot(a, b) / lengths, -1., 1.)) * 180 / std::numbers::pi : 90;
}

/// Percent of joints within `limit_mm`, inclusive.
double share_within(const std::array<double, kJoints>& errors_mm, double limit_mm) {
  const auto within =
      std::count_if(errors_mm.begin(), errors_mm.end(), [&](double error) { return error <= limit_mm; });
  return 100. * static_cast<double>(within) / kJoints;
}

}  // namespace

std::array<double, kJoints> joint_errors_mm(const Skeleton& predicted, const Skeleton& person) {
  std::array<double, kJoints> errors;
  for (std::size_t j = 0; j < kJoints; ++j) errors[j] = 1000 * distance_m(predicted[j], person[j]);
  return errors;
}

std::string_view name_of(Posture posture) {
  constexpr std::array<std::string_view, kPostures> kNames = {"low", "bent", "arms_raised", "upright"};
  return kNames[static_cast<std::size_t>(posture)];
}

Posture posture_of(const Skeleton& person) {
  const auto at = [&](std::size_t joint) { return vector_of(person[joint]); };
  const Vector root = vector_of(root_of(person)), trunk = minus(at(kNeck), root);
  Vector rise = root;  // from between the ankles to the hips
  for (std::size_t k = 0; k < 3; ++k) rise[k] -= (at(kLeftAnkle)[k] + at(kRightAnkle)[k]) / 2;
  const double legs_m =
      (distance_m(person[kLeftHip], person[kLeftKnee]) + distance_m(person[kLeftKnee], person[kLeftAnkle]) +
       distance_m(person[kRightHip], person[kRightKnee]) +
       distance_m(person[kRightKnee], person[kRightAnkle])) /
      2;
  if (length(rise) < kLowLegs * legs_m) return Posture::low;
  if (angle_deg(trunk, rise) > kBentTrunk_deg) return Posture::bent;
  for (const std::size_t hand : {kLeftHand, kRightHand})
    if (dot(minus(at(hand), at(kNeck)), trunk) > 0) return Posture::arms_raised;
  return Posture::upright;
}

Skeleton aligned(const Skeleton& predicted, const Skeleton& person) {
  const Vector from = centre(predicted), to = centre(person);
  std::array<Vector, 3> sums{};
  double spread = 0;
  for (std::size_t j = 0; j < kJoints; ++j) {
    const Vector p = minus(vector_of(predicted[j]), from), g = minus(vector_of(person[j]), to);
    spread += dot(p, p);
    for (std::size_t i = 0; i < 3; ++i)
      for (std::size_t k = 0; k < 3; ++k) sums[i][k] += p[i] * g[k];
  }
  const bool is_point = spread < 1e-12;
  const Turn turn = best_turn(sums);
  const double scale = is_point ? 0 : turn.gain / spread;
  Skeleton result;
  for (std::size_t j = 0; j < kJoints; ++j) {
    const Vector v = turned(turn.quaternion, minus(vector_of(predicted[j]), from));
    result[j] = {static_cast<float>(to[0] + scale * v[0]), static_cast<float>(to[1] + scale * v[1]),
                 static_cast<float>(to[2] + scale * v[2])};
  }
  return result;
}

PoseErrors pose_errors(const Skeleton& predicted, const Skeleton& person) {
  const std::array<double, kJoints> errors = joint_errors_mm(predicted, person);
  PoseErrors result;
  const Vector root_off = minus(vector_of(root_of(predicted)), vector_of(root_of(person)));
  result.mrpe = 1000 * length(root_off);
  for (std::size_t j = 0; j < kJoints; ++j) {
    result.mpjpe += errors[j] / kJoints;
    const Vector d = minus(vector_of(predicted[j]), vector_of(person[j]));
    for (std::size_t k = 0; k < 3; ++k) result.axis[k] += 1000 * std::abs(d[k]) / kJoints;
    result.root_mpjpe += 1000 * length(minus(d, root_off)) / kJoints;
  }
  const Vector across = vector_of(left_to_right(predicted)), truly = vector_of(left_to_right(person));
  result.facing_deg = angle_deg(across, truly);
  result.breadth_mm = 1000 * (length(across) - length(truly));
  result.pa_mpjpe = 1000 * mean_joint_distance_m(aligned(predicted, person), person);
  const double torso_mm = 1000 * distance_m(person[kRightShoulder], person[kLeftHip]);
  const double elbows_mm = 1000 * distance_m(person[kRightElbow], person[kLeftElbow]);
  result.pck20 = share_within(errors, 0.2 * torso_mm), result.pck50 = share_within(errors, 0.5 * torso_mm);
  result.pck20_elbows = share_within(errors, 0.2 * elbows_mm);
  result.pck50_elbows = share_within(errors, 0.5 * elbows_mm);
  result.pck20mm = share_within(errors, 20), result.pck50mm = share_within(errors, 50);
  return result;
}

}  // namespace csipose
