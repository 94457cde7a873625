#include "model/postprocess.h"

#include <algorithm>
#include <array>
#include <cassert>
#include <cmath>

#include "proto/pose_geometry.h"

namespace csipose {
namespace {

bool all_finite(std::span<const float> numbers) {
  return std::all_of(numbers.begin(), numbers.end(), [](float value) { return std::isfinite(value); });
}

/// Ordered by logit: scores near 1 all round to 1, and would leave the order to chance.
struct Candidate {
  std::size_t query;
  float logit, score;
};

Skeleton skeleton_of(std::span<const float> pose, const RoomTransform& model_to_room) {
  Skeleton joints;
  for (std::size_t j = 0; j < kJoints; ++j) joints[j] = to_room(model_to_room, &pose[3 * j]);
  return joints;
}

bool is_double(const Skeleton& joints, std::span<const Person> better, float nms_distance_m) {
  return std::any_of(better.begin(), better.end(), [&](const Person& other) {
    return mean_joint_distance_m(joints, other.joints) < static_cast<double>(nms_distance_m);
  });
}

void fill_confidences(std::span<const float> sigma_m, const Calibration& calibration, Person& person) {
  person.sigma_m.fill(kUnknown);
  person.confidence.fill(kUnknown);
  if (sigma_m.empty()) return;
  for (std::size_t j = 0; j < kJoints; ++j) {
    person.sigma_m[j] = expected_error_m(sigma_m[j], j, calibration);
    person.confidence[j] = joint_confidence(person.sigma_m[j], calibration);
  }
}

Person person_of(const Candidate& candidate, const NetworkOutput& output, const Model& model) {
  const std::size_t q = candidate.query;
  Person person;
  person.score = candidate.score;
  person.joints = skeleton_of(output.poses.subspan(q * kPoseWidth, kPoseWidth), model.model_to_room());
  person.joints_raw = person.joints;
  const auto sigma_m = output.sigma_m.empty() ? output.sigma_m : output.sigma_m.subspan(q * kJoints, kJoints);
  fill_confidences(sigma_m, model.calibration(), person);
  return person;
}

/// The queries that reach min_score, best first.
std::span<const Candidate> rank(const NetworkOutput& output, const Calibration& calibration, float min_score,
                                std::array<Candidate, kTokens>& storage) {
  assert(output.logits.size() <= storage.size());
  auto end = storage.begin();
  for (std::size_t q = 0; q < output.logits.size(); ++q) {
    const float score = person_score(output.logits[q], calibration);
    if (score >= min_score) *end++ = {q, output.logits[q], score};
  }
  std::sort(storage.begin(), end, [](const Candidate& a, const Candidate& b) {
    return a.logit != b.logit ? a.logit > b.logit : a.query < b.query;
  });
  return {storage.begin(), end};
}

float on_curve(const ConfidenceCurve& curve, float raw) {
  const auto upper = std::upper_bound(curve.raw.begin(), curve.raw.end(), raw);
  if (upper == curve.raw.begin()) return curve.corrected.front();
  if (upper == curve.raw.end()) return curve.corrected.back();
  const auto i = static_cast<std::size_t>(upper - curve.raw.begin());
  const float part = (raw - curve.raw[i - 1]) / (curve.raw[i] - curve.raw[i - 1]);
  return curve.corrected[i - 1] + part * (curve.corrected[i] - curve.corrected[i - 1]);
}

}  // namespace

float person_score(float logit, const Calibration& calibration) {
  const float z = calibration.score ? calibration.score->a * logit + calibration.score->b : logit;
  return 1 / (1 + std::exp(-z));
}

float expected_error_m(float sigma_m, std::size_t joint, const Calibration& calibration) {
  return calibration.joint_scale ? sigma_m * (*calibration.joint_scale)[joint] : sigma_m;
}

float joint_confidence(float expected_m, const Calibration& calibration) {
  const float raw = 1 - std::exp(-kConfidentError_m / expected_m);
  return calibration.confidence ? on_curve(*calibration.confidence, raw) : raw;
}

Point3 to_room(const RoomTransform& m, const float* p) {
  const auto row = [&](std::size_t r) { return m[r][0] * p[0] + m[r][1] * p[1] + m[r][2] * p[2] + m[r][3]; };
  return {row(0), row(1), row(2)};
}

Selected select_people(const NetworkOutput& output, const Model& model, const Selection& selection,
                       std::span<Person> people) {
  assert(output.poses.size() == output.logits.size() * kPoseWidth);
  if (!all_finite(output.logits) || !all_finite(output.poses) || !all_finite(output.sigma_m))
    return {0, true};
  std::array<Candidate, kTokens> storage;
  Selected selected;
  const std::size_t most = std::min({selection.max_people, people.size(), kMaxPeople});
  for (const Candidate& candidate : rank(output, model.calibration(), selection.min_score, storage)) {
    if (selected.count == most) break;
    const Person person = person_of(candidate, output, model);
    if (is_double(person.joints, people.first(selected.count), selection.nms_distance_m)) continue;
    selected.query[selected.count] = candidate.query;
    people[selected.count++] = person;
  }
  return selected;
}

}  // namespace csipose
