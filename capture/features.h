// capture/features.h - one record to the 60 x 3 numbers that it adds to a window: amplitudes, then sanitised
// phases.
#pragma once

#include <array>

#include "capture/sanitise.h"
#include "capture/scale.h"
#include "proto/csi_record.h"

namespace csipose {

/// [c][antenna]: c = 0..29 amplitude of subcarrier c; c = 30..59 phase of subcarrier c - 30, in (-pi, pi]
/// before it is rounded to float.
using Features = std::array<float, kChannels * kAntennas>;

struct FeatureOptions {
  PhaseMethod phase = PhaseMethod::joint;
  AmplitudeMethod amplitude = AmplitudeMethod::raw;
  int stream = 0;
  bool undo_40mhz_rotation = true;
};

/// Features of one stream of a usable record.
///   returns  false, and `out` untouched: the record has no such stream, or scaled amplitudes were asked for
///   and it
///            cannot be scaled
///   requires record.usable()
///   cost     some 4 us, nearly all of it arguments; no allocation
bool extract_features(const CsiRecord& record, const FeatureOptions& options, Features& out);

/// Features of CSI that is in no record, such as a simulator's array; amplitudes times `scale`.
Features features_of(const StreamCsi& h, PhaseMethod phase, bool is_40mhz, double scale);

}  // namespace csipose
