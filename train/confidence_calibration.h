// train/confidence_calibration.h - what a model says of its own certainty, fitted to what came true on validation windows.
//
//   person score       sigmoid(a logit + b) against being matched within 0.5 m
//   expected error     one factor per joint, so that the mean expected error is the mean error
//   joint confidence   a rising curve of 20 knots, after those factors, against an error under kConfidentError_m
//
// What is fitted is what model/postprocess.h applies, by its own functions. People below the score's threshold of
// `detect` are not seen here: for them the person score is carried on.
#pragma once

#include <span>

#include "train/evaluation.h"

namespace csipose::train {

/// Of the same statements, by the two calibrations.
struct BeforeAndAfter {
  Reliability before, after;
};

struct ConfidenceFit {
  Calibration
      calibration;  ///< score, joint_scale and confidence as far as there was something to fit; the rest empty
  std::size_t found = 0, matched = 0;  ///< people whom `detect` gave, and those of them who were there
  BeforeAndAfter score, joints;
};
/// `before`: the calibration that the model had. A score for which no rising curve fits is left as the network gives it
/// (fit_platt); joints are left out where nobody was matched or the model has no head for the expected error.
ConfidenceFit fit_confidences(std::span<const Detection> detections, const Calibration& before);

}  // namespace csipose::train
