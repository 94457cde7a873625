#include "train/confidence_calibration.h"

#include <cmath>

namespace csipose::train {
namespace {

bool has_joints(const Detection& detection) {
  return detection.match != kMissed && !std::isnan(detection.sigma_m.front());
}

std::array<float, kJoints> fit_joint_scale(std::span<const Detection> detections) {
  std::array<double, kJoints> error{}, sigma{};
  for (const Detection& detection : detections)
    for (std::size_t j = 0; has_joints(detection) && j < kJoints; ++j) {
      error[j] += static_cast<double>(detection.error_m[j]);
      sigma[j] += static_cast<double>(detection.sigma_m[j]);
    }
  std::array<float, kJoints> scale;
  for (std::size_t j = 0; j < kJoints; ++j) scale[j] = static_cast<float>(error[j] / sigma[j]);
  return scale;
}

/// What `calibration` says of every joint of those matched.
std::vector<Verdict> joint_verdicts(std::span<const Detection> detections, const Calibration& calibration) {
  std::vector<Verdict> verdicts;
  for (const Detection& detection : detections)
    for (std::size_t j = 0; has_joints(detection) && j < kJoints; ++j) {
      const float expected_m = expected_error_m(detection.sigma_m[j], j, calibration);
      verdicts.push_back({static_cast<double>(joint_confidence(expected_m, calibration)),
                          detection.error_m[j] < kConfidentError_m});
    }
  return verdicts;
}

std::vector<Verdict> logit_verdicts(std::span<const Detection> found, std::span<const Detection> faint) {
  std::vector<Verdict> verdicts;
  for (const auto detections : {found, faint})
    for (const Detection& detection : detections)
      verdicts.push_back({static_cast<double>(detection.logit), detection.match != kMissed});
  return verdicts;
}

Reliability score_reliability(std::span<const Detection> detections, const Calibration& calibration) {
  Reliability reliability;
  for (const Detection& detection : detections)
    reliability.add(static_cast<double>(person_score(detection.logit, calibration)),
                    detection.match != kMissed);
  return reliability;
}

Reliability joint_reliability(std::span<const Detection> detections, const Calibration& calibration) {
  Reliability reliability;
  for (const Verdict& verdict : joint_verdicts(detections, calibration))
    reliability.add(verdict.said, verdict.came_true);
  return reliability;
}

}  // namespace

ConfidenceFit fit_confidences(std::span<const Detection> found, std::span<const Detection> faint,
                              const Calibration& before) {
  ConfidenceFit fit;
  bool joints = false;
  for (const Detection& detection : found) {
    ++fit.found;
    fit.matched += detection.match != kMissed;
    joints = joints || has_joints(detection);
  }
  fit.calibration.score = fit_platt(logit_verdicts(found, faint));
  if (joints) {
    fit.calibration.joint_scale = fit_joint_scale(found);
    fit.calibration.confidence = fit_curve(joint_verdicts(found, fit.calibration));
  }
  fit.score = {score_reliability(found, before), score_reliability(found, fit.calibration)};
  fit.joints = {joint_reliability(found, before), joint_reliability(found, fit.calibration)};
  return fit;
}

}  // namespace csipose::train
