#include "capture/features.h"

#include <cassert>
#include <cmath>

namespace csipose {
bool extract_features(const CsiRecord& record, const FeatureOptions& options, Features& out) {
  assert(record.usable() && options.stream >= 0);
  const auto stream = static_cast<std::size_t>(options.stream);
  if (stream >= record.ntx) return false;
  const std::optional<double> scale =
      options.amplitude == AmplitudeMethod::scaled ? scale_factor(record) : std::optional<double>(1);
  if (!scale) return false;

  out = features_of(stream_csi(record, stream, options.undo_40mhz_rotation), options.phase, record.is_40mhz(),
                    *scale);
  return true;
}

Features features_of(const StreamCsi& h, PhaseMethod phase_method, bool is_40mhz, double scale) {
  Features out;
  const StreamPhase phase =
      phase_method == PhaseMethod::joint ? sanitise_joint(h) : sanitise_phasefi(h, is_40mhz);
  for (std::size_t k = 0; k < kSubcarriers; ++k)
    for (std::size_t antenna = 0; antenna < kAntennas; ++antenna) {
      out[k * kAntennas + antenna] = static_cast<float>(std::sqrt(std::norm(h[antenna][k])) * scale);
      out[(kSubcarriers + k) * kAntennas + antenna] = static_cast<float>(wrap_phase(phase[antenna][k]));
    }
  return out;
}

}  // namespace csipose
