#include "capture/sanitise.h"

#include <cmath>
#include <numbers>
#include <numeric>

#include "proto/intel5300.h"

namespace csipose {
namespace {

constexpr double kPi = std::numbers::pi;
constexpr double kMiddle = (kSubcarriers - 1) / 2.0;
/// Sum over three antennas of (k - 14.5)^2.
constexpr double kSpread = 6742.5;

using Subcarriers = std::array<std::complex<double>, kSubcarriers>;

/// Phase of a * conj(b), in plain IEEE arithmetic: where a or b is 0 the answer is 0 or +-pi by the signs of
/// zeros, as in the original code, whose lines are fitted through these phases too.
double phase_difference(std::complex<double> a, std::complex<double> b) {
  return std::atan2(a.real() * -b.imag() + a.imag() * b.real(), a.real() * b.real() - a.imag() * -b.imag());
}

/// Remainder of the divisor's sign, as NumPy's mod.
double positive_modulo(double x, double divisor) {
  const double remainder = std::fmod(x, divisor);
  return remainder < 0 ? remainder + divisor : remainder;
}

/// Phase of an antenna as that of the one before plus the difference between them.
std::array<double, kSubcarriers> follow(const std::array<double, kSubcarriers>& before_rad,
                                        const Subcarriers& before, const Subcarriers& h) {
  std::array<double, kSubcarriers> phase;
  for (std::size_t k = 0; k < kSubcarriers; ++k) phase[k] = before_rad[k] + phase_difference(h[k], before[k]);
  unwrap(phase);
  return phase;
}

std::array<double, kSubcarriers> unwrapped_phase(const Subcarriers& h) {
  std::array<double, kSubcarriers> phase;
  for (std::size_t k = 0; k < kSubcarriers; ++k) phase[k] = std::arg(h[k]);
  unwrap(phase);
  return phase;
}

}  // namespace

StreamCsi stream_csi(const CsiRecord& record, std::size_t stream, bool undo_40mhz_rotation) {
  const bool rotate = undo_40mhz_rotation && record.is_40mhz();
  const auto& number = subcarrier_indices(record.is_40mhz());
  StreamCsi h;
  for (std::size_t k = 0; k < kSubcarriers; ++k)
    for (std::size_t antenna = 0; antenna < kAntennas; ++antenna) {
      const std::size_t i = CsiRecord::index(k, antenna, stream);
      const double re = record.csi[i], im = record.csi[i + 1];
      h[antenna][k] = rotate && number[k] > 0 ? std::complex<double>(im, -re) : std::complex<double>(re, im);
    }
  return h;
}

void unwrap(std::array<double, kSubcarriers>& phase_rad) {
  double correction = 0, last = phase_rad[0];
  for (std::size_t k = 1; k < kSubcarriers; ++k) {
    const double step = phase_rad[k] - last;
    last = phase_rad[k];
    if (std::abs(step) >= kPi) {
      double wrapped = positive_modulo(step + kPi, 2 * kPi) - kPi;
      if (wrapped == -kPi && step > 0) wrapped = kPi;
      correction += wrapped - step;
    }
    phase_rad[k] += correction;
  }
}

double wrap_phase(double phase_rad) {
  const double wrapped = std::remainder(phase_rad, 2 * kPi);
  return wrapped <= -kPi ? kPi : wrapped;
}

StreamPhase joint_unwrapped(const StreamCsi& h) {
  static_assert(kAntennas == 3);
  StreamPhase phase;
  phase[0] = unwrapped_phase(h[0]);
  phase[1] = follow(phase[0], h[0], h[1]);
  phase[2] = follow(phase[1], h[1], h[2]);
  return phase;
}

/// Sums are taken about the middle subcarrier: no large numbers, and no determinant that could vanish.
PhaseLine fit_line(const StreamPhase& phase_rad) {
  double sum = 0, moment = 0;
  for (const auto& antenna : phase_rad)
    for (std::size_t k = 0; k < kSubcarriers; ++k) {
      sum += antenna[k];
      moment += (static_cast<double>(k) - kMiddle) * antenna[k];
    }
  const double slope = moment / kSpread;
  return {.slope_rad = slope, .intercept_rad = sum / (kAntennas * kSubcarriers) - slope * kMiddle};
}

StreamPhase sanitise_joint(const StreamCsi& h) {
  StreamPhase phase = joint_unwrapped(h);
  const PhaseLine line = fit_line(phase);
  for (auto& antenna : phase)
    for (std::size_t k = 0; k < kSubcarriers; ++k)
      antenna[k] = wrap_phase(antenna[k] - line.slope_rad * static_cast<double>(k) - line.intercept_rad);
  return phase;
}

StreamPhase sanitise_phasefi(const StreamCsi& h, bool is_40mhz) {
  const auto& number = subcarrier_indices(is_40mhz);
  StreamPhase phase;
  for (std::size_t antenna = 0; antenna < kAntennas; ++antenna) {
    auto& p = phase[antenna];
    p = unwrapped_phase(h[antenna]);
    const double slope = (p.back() - p.front()) / (number.back() - number.front());
    const double mean = std::accumulate(p.begin(), p.end(), 0.0) / kSubcarriers;
    for (std::size_t k = 0; k < kSubcarriers; ++k) p[k] -= slope * number[k] + mean;
  }
  return phase;
}

}  // namespace csipose
