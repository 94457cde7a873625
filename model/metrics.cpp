#include "model/metrics.h"

#include <algorithm>
#include <cmath>
#include <nlohmann/json.hpp>
#include <numbers>

#include "model/assignment.h"

namespace csipose {
namespace {

constexpr double kTooFar_m = 0.5;      // detect
constexpr double kGreedyLimit_m = 50;  // piw3d
constexpr double kMissedPenalty_mm = 500;
constexpr std::size_t kNeck = 0, kLeftElbow = 4, kRightElbow = 6, kLeftHand = 8, kLeftKnee = 9,
                      kRightHand = 10, kRightKnee = 11, kLeftAnkle = 12, kRightAnkle = 13;
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
double distance_m(const Point3& a, const Point3& b) { return length(minus(vector_of(a), vector_of(b))); }
double mean_distance_m(const Skeleton& a, const Skeleton& b) {
  double sum = 0;
  for (std::size_t j = 0; j < kJoints; ++j) sum += distance_m(a[j], b[j]);
  return sum / kJoints;
}
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

template <class Operation>
void combine(PoseErrors& a, const PoseErrors& b, Operation operation) {
  operation(a.mpjpe, b.mpjpe);
  for (std::size_t k = 0; k < 3; ++k) operation(a.axis[k], b.axis[k]);
  operation(a.mrpe, b.mrpe), operation(a.root_mpjpe, b.root_mpjpe), operation(a.pa_mpjpe, b.pa_mpjpe);
  operation(a.facing_deg, b.facing_deg), operation(a.breadth_mm, b.breadth_mm);
  operation(a.pck20, b.pck20), operation(a.pck50, b.pck50);
  operation(a.pck20_elbows, b.pck20_elbows), operation(a.pck50_elbows, b.pck50_elbows);
  operation(a.pck20mm, b.pck20mm), operation(a.pck50mm, b.pck50mm);
}
void add(PoseErrors& sum, const PoseErrors& one, double weight) {
  combine(sum, one, [weight](double& a, double b) { a += weight * b; });
}
PoseErrors divided(PoseErrors sum, std::size_t count) {  // by 0: not a number, as it should be
  combine(sum, sum, [count](double& a, double) { a /= static_cast<double>(count); });
  return sum;
}
double ratio(std::size_t part, std::size_t whole) {
  return static_cast<double>(part) / static_cast<double>(whole);
}

std::vector<std::size_t> match_greedily(std::span<const Skeleton> predicted,
                                        std::span<const Skeleton> people) {
  std::vector<std::size_t> matches(people.size(), kMissed);
  if (predicted.empty()) return matches;
  std::vector<char> used(predicted.size(), 0);
  for (std::size_t pass = 0; pass < std::min(predicted.size(), people.size()); ++pass) {
    double nearest_m = kGreedyLimit_m;
    std::size_t person = kMissed, prediction = kMissed;
    for (std::size_t i = 0; i < predicted.size(); ++i)
      for (std::size_t j = 0; j < people.size(); ++j) {
        if (used[i] || matches[j] != kMissed) continue;
        const double d_m = mean_distance_m(predicted[i], people[j]);
        if (d_m < nearest_m) nearest_m = d_m, person = j, prediction = i;
      }
    if (person == kMissed) break;
    matches[person] = prediction;
    used[prediction] = 1;
  }
  std::replace(matches.begin(), matches.end(), kMissed, predicted.size() - 1);
  return matches;
}

/// Pairs further apart than `limit_m` do not count.
std::vector<std::size_t> match_optimally(std::span<const Skeleton> predicted,
                                         std::span<const Skeleton> people, double limit_m) {
  std::vector<std::size_t> matches(people.size(), kMissed);
  if (predicted.empty() || people.empty()) return matches;
  std::vector<double> cost_m;
  for (const Skeleton& person : people)
    for (const Skeleton& prediction : predicted) cost_m.push_back(mean_distance_m(prediction, person));
  Assignment assignment(people.size(), predicted.size());
  const auto columns = assignment.solve(cost_m, people.size(), predicted.size());
  for (std::size_t j = 0; j < people.size(); ++j)
    if (columns[j] != kUnassigned && cost_m[j * predicted.size() + columns[j]] <= limit_m)
      matches[j] = columns[j];
  return matches;
}

}  // namespace

std::array<double, kJoints> joint_errors_mm(const Skeleton& predicted, const Skeleton& person) {
  std::array<double, kJoints> errors;
  for (std::size_t j = 0; j < kJoints; ++j) errors[j] = 1000 * distance_m(predicted[j], person[j]);
  return errors;
}

Point3 left_to_right(const Skeleton& pose) {
  const Point3 &ls = pose[kLeftShoulder], &rs = pose[kRightShoulder], &lh = pose[kLeftHip],
               &rh = pose[kRightHip];
  return {(rs.x - ls.x + rh.x - lh.x) / 2, (rs.y - ls.y + rh.y - lh.y) / 2, (rs.z - ls.z + rh.z - lh.z) / 2};
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
  result.pa_mpjpe = 1000 * mean_distance_m(aligned(predicted, person), person);
  const double torso_mm = 1000 * distance_m(person[kRightShoulder], person[kLeftHip]);
  const double elbows_mm = 1000 * distance_m(person[kRightElbow], person[kLeftElbow]);
  result.pck20 = share_within(errors, 0.2 * torso_mm), result.pck50 = share_within(errors, 0.5 * torso_mm);
  result.pck20_elbows = share_within(errors, 0.2 * elbows_mm);
  result.pck50_elbows = share_within(errors, 0.5 * elbows_mm);
  result.pck20mm = share_within(errors, 20), result.pck50mm = share_within(errors, 50);
  return result;
}

std::string_view name_of(Protocol protocol) {
  switch (protocol) {
    case Protocol::piw3d:
      return "piw3d";
    case Protocol::detect:
      return "detect";
    case Protocol::assigned:
      break;
  }
  return "assigned";
}

std::vector<std::size_t> match(Protocol protocol, std::span<const Skeleton> predicted,
                               std::span<const Skeleton> people) {
  if (protocol == Protocol::piw3d) return match_greedily(predicted, people);
  return match_optimally(predicted, people, protocol == Protocol::detect ? kTooFar_m : HUGE_VAL);
}

double GroupMetrics::precision() const { return ratio(matched, predicted); }
double GroupMetrics::recall() const { return ratio(matched, people); }
double GroupMetrics::f1() const { return ratio(2 * matched, predicted + people); }
double GroupMetrics::count_accuracy() const { return ratio(right_count, frames); }

void Metrics::add(std::span<const Skeleton> predicted, std::span<const Skeleton> people) {
  const std::vector<std::size_t> matches = match(protocol_, predicted, people);
  const auto matched = static_cast<std::size_t>(
      std::count_if(matches.begin(), matches.end(), [](std::size_t m) { return m != kMissed; }));
  const std::array<Sums*, 2> groups = {&all_, &by_count_[people.size()]};
  for (Sums* sums : groups) {
    GroupMetrics& counts = sums->counts;
    ++counts.frames;
    sums->frames_matched += matched > 0;
    counts.frames_unmatched += matched == 0 && !people.empty();
    counts.people += people.size();
    counts.matched += matched;
    counts.predicted += predicted.size();
    counts.right_count += predicted.size() == people.size();
  }
  for (std::size_t j = 0; j < people.size(); ++j) {
    PostureMetrics& alike = by_posture_[static_cast<std::size_t>(posture_of(people[j]))];
    ++alike.people;
    if (matches[j] == kMissed) continue;
    const Skeleton& prediction = predicted[matches[j]];
    const PoseErrors errors = pose_errors(prediction, people[j]);
    const std::array<double, kJoints> joints = joint_errors_mm(prediction, people[j]);
    ++alike.matched;
    csipose::add(alike.person_mean, errors, 1);
    for (Sums* sums : groups) {
      csipose::add(sums->by_person, errors, 1);
      csipose::add(sums->by_frame, errors, 1 / static_cast<double>(matched));
      for (std::size_t k = 0; k < kJoints; ++k) sums->joints[k] += joints[k];
    }
  }
}

GroupMetrics Metrics::Sums::means() const {
  GroupMetrics means = counts;
  means.frame_mean = divided(by_frame, frames_matched);
  means.person_mean = divided(by_person, counts.matched);
  for (std::size_t k = 0; k < kJoints; ++k)
    means.per_joint[k] = joints[k] / static_cast<double>(counts.matched);
  const auto missed = static_cast<double>(counts.people - counts.matched);
  means.penalised_500 = (by_person.mpjpe + kMissedPenalty_mm * missed) / static_cast<double>(counts.people);
  return means;
}

PostureMetrics Metrics::by_posture(Posture posture) const {
  PostureMetrics group = by_posture_[static_cast<std::size_t>(posture)];
  group.person_mean = divided(group.person_mean, group.matched);
  return group;
}

std::map<std::size_t, GroupMetrics> Metrics::by_count() const {
  std::map<std::size_t, GroupMetrics> groups;
  for (const auto& [count, sums] : by_count_) groups[count] = sums.means();
  return groups;
}

namespace {
nlohmann::ordered_json errors_json(const PoseErrors& e) {
  return {{"mpjpe", e.mpjpe},
          {"err_x", e.axis[0]},
          {"err_y", e.axis[1]},
          {"err_z", e.axis[2]},
          {"h", e.axis[0]},
          {"v", e.axis[1]},
          {"d", e.axis[2]},
          {"mrpe", e.mrpe},
          {"root_mpjpe", e.root_mpjpe},
          {"pa_mpjpe", e.pa_mpjpe},
          {"facing_deg", e.facing_deg},
          {"breadth_mm", e.breadth_mm},
          {"pck20", e.pck20},
          {"pck50", e.pck50},
          {"pck20_dtpose", e.pck20_elbows},
          {"pck50_dtpose", e.pck50_elbows},
          {"pck20mm", e.pck20mm},
          {"pck50mm", e.pck50mm}};
}

nlohmann::ordered_json group_json(const GroupMetrics& group, Protocol protocol) {
  nlohmann::ordered_json json = errors_json(group.frame_mean);
  json["elbows"] = (group.per_joint[kLeftElbow] + group.per_joint[kRightElbow]) / 2;
  json["hands"] = (group.per_joint[kLeftHand] + group.per_joint[kRightHand]) / 2;
  json["mpjpe_penalised_500"] = group.penalised_500;
  json["frames"] = group.frames;
  json["frames_unmatched"] = group.frames_unmatched;
  json["people"] = group.people;
  if (protocol == Protocol::detect) {
    json["precision"] = group.precision();
    json["recall"] = group.recall();
    json["f1"] = group.f1();
    json["count_accuracy"] = group.count_accuracy();
  }
  json["person_mean"] = errors_json(group.person_mean);
  return json;
}
}  // namespace

std::string metrics_json(const Metrics& metrics) {
  const GroupMetrics all = metrics.all();
  nlohmann::ordered_json json;
  json["protocol"] = name_of(metrics.protocol());
  json["n_frames"] = all.frames;
  json["all"] = group_json(all, metrics.protocol());
  for (const auto& [count, group] : metrics.by_count())
    json["by_count"][std::to_string(count)] = group_json(group, metrics.protocol());
  for (std::size_t i = 0; i < kPostures; ++i) {
    const auto posture = static_cast<Posture>(i);
    const PostureMetrics group = metrics.by_posture(posture);
    nlohmann::ordered_json& figures = json["by_posture"][std::string(name_of(posture))];
    figures = {{"people", group.people},
               {"mpjpe", group.person_mean.mpjpe},
               {"mrpe", group.person_mean.mrpe},
               {"root_mpjpe", group.person_mean.root_mpjpe},
               {"pa_mpjpe", group.person_mean.pa_mpjpe},
               {"facing_deg", group.person_mean.facing_deg}};
    if (metrics.protocol() == Protocol::detect) figures["recall"] = ratio(group.matched, group.people);
  }
  json["per_joint"] = all.per_joint;
  return json.dump();
}

}  // namespace csipose
