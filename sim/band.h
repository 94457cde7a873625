// sim/band.h - the subcarriers that an Intel 5300 reports, as frequencies.
#pragma once

#include <array>
#include <complex>

#include "proto/intel5300.h"
#include "proto/shape.h"

namespace csipose::sim {

inline constexpr double kSpeedOfLight_m_s = 299'792'458.0;  ///< exact
inline constexpr double kToneSpacing_hz = 312'500.0;        ///< 802.11n

struct Band {
  double carrier_hz = 5.64e9;  ///< channel 128
  bool is_40mhz = false;

  double offset_hz(std::size_t k) const { return subcarrier_indices(is_40mhz)[k] * kToneSpacing_hz; }
  double frequency_hz(std::size_t k) const { return carrier_hz + offset_hz(k); }
  /// At the carrier; amplitudes and materials are taken there, only phases follow the subcarrier.
  double wavelength_m() const { return kSpeedOfLight_m_s / carrier_hz; }
};

/// Voltage gain from the transmitter to the antennas of one receiver, [subcarrier][antenna]; e^{+jwt}
/// convention, so a path of delay tau turns by e^{-j 2 pi f tau}. |h|^2 is received over transmitted power.
using ReceiverChannel = std::array<std::array<std::complex<double>, kAntennas>, kSubcarriers>;
/// The same for all receivers, [receiver].
using Channel = std::array<ReceiverChannel, kReceivers>;

}  // namespace csipose::sim
