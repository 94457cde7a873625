// capture/sanitise.h - undo what the radio did to the phase, keep what the room did.
//
// Each packet starts at an unknown sample and an unknown oscillator phase. Both draw a straight line of phase
// against frequency: slope = timing, intercept = carrier. Two ways to take the line out:
//
//   joint    one line for all three antennas, so that differences between antennas, which carry the angle
//            of arrival, stay. As in the code of Person-in-WiFi 3D (aiotgroup/Person-in-WiFi-3D-repo,
//            CSI_sanitization), after SpotFi (SIGCOMM 2015).
//   phasefi  one line per antenna through its first and last subcarrier (PhaseFi, GLOBECOM 2015).
//
// Where phase is undefined: an entry of 0 has none. It is given 0 or +-pi as the original code's arithmetic
// gives it, because the fitted line hangs on it, and who compares must mask it. Quantised weak antennas make
// steps of exactly pi, where unwrapping hangs on the last bit; nothing can be done about that here.
// Not here: the clocks of different receivers (aligner.h).
#pragma once

#include <array>
#include <complex>

#include "proto/csi_record.h"

namespace csipose {

enum class PhaseMethod : std::uint8_t { joint, phasefi };

/// One stream of one record: [antenna][subcarrier]. Integers in double, hence exact.
using StreamCsi = std::array<std::array<std::complex<double>, kSubcarriers>, kAntennas>;
/// Radians, [antenna][subcarrier].
using StreamPhase = std::array<std::array<double, kSubcarriers>, kAntennas>;

/// phase = slope_rad * k + intercept_rad, k = 0..29 counted, not the subcarrier's true number.
struct PhaseLine {
  double slope_rad = 0;
  double intercept_rad = 0;
};

/// The raw CSI of one stream. With `undo_40mhz_rotation` the +90 degrees that 802.11n puts on the upper half
/// of a 40 MHz channel are taken off (subcarriers above 0, times -j); no peer does so, and without it no line
/// fits.
StreamCsi stream_csi(const CsiRecord& record, std::size_t stream, bool undo_40mhz_rotation);

/// NumPy's unwrap: adds turns so that no step is larger than half a turn. In place.
void unwrap(std::array<double, kSubcarriers>& phase_rad);

/// The same direction within (-pi, pi].
double wrap_phase(double phase_rad);

/// Phases unwrapped along subcarriers, antenna 1 tied to antenna 0 and antenna 2 to antenna 1: what joint
/// fits.
StreamPhase joint_unwrapped(const StreamCsi& h);
/// Least-squares line through all 90 phases.
PhaseLine fit_line(const StreamPhase& phase_rad);

/// Joint: the line of all antennas removed; in (-pi, pi].
///   cost  some 3 us (90 arguments in double), no allocation
StreamPhase sanitise_joint(const StreamCsi& h);

/// PhaseFi: per antenna the line through the band's ends and the mean removed; not wrapped, reaches beyond
/// +-pi.
StreamPhase sanitise_phasefi(const StreamCsi& h, bool is_40mhz);

}  // namespace csipose
