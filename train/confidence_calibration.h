// train/confidence_calibration.h - what a model says of its own certainty, fitted to what came true on validation windows.
//
//   person score       sigmoid(a logit + b) against being matched within 0.5 m
//   expected error     one factor per joint, so that the mean expected error is the mean error
//   joint confidence   a rising curve of 20 knots, after those factors, against an error under kConfidentError_m
//
// What is fitted is what model/postprocess.h applies, by its own functions. The score is fitted to those whom `detect`
// gives and to the fainter ones too: the daemon's threshold is on the calibrated score, and a curve that was carried on
// below all it had seen would let anybody through.
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
/// `found` and `faint` of all answers (train/evaluation.h); `before`: the calibration that the model had. Joints, and both
/// reliabilities, are of those found. A score for which no rising curve fits is left as the network gives it
/// (fit_platt); joints are left out where nobody was matched or the model has no head for the expected error.
ConfidenceFit fit_confidences(std::span<const Detection> found, std::span<const Detection> faint,
                              const Calibration& before);

}  // namespace csipose::train
