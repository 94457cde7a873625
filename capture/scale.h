// capture/scale.h - from the receiver's counts to a channel in units of sqrt(signal-to-noise ratio).
//
// The card reports CSI as its gain control left it. RSSI and gain tell the power that came in, so one
// positive factor per record gives absolute amplitudes; phases stay. And a transmitter of two or three
// streams sends them through a fixed unitary matrix Q, which can be taken out again.
// Source: linux-80211n-csitool-supplementary matlab/get_scaled_csi.m, get_total_rss.m, remove_sm.m.
#pragma once

#include <array>
#include <complex>
#include <optional>
#include <span>

#include "proto/csi_record.h"

namespace csipose {

enum class AmplitudeMethod : std::uint8_t { raw, scaled };

/// H of one record, [k][antenna][stream] with T streams, T = size / 90; absent antennas and streams are 0.
using CsiMatrix = std::span<std::complex<float>>;
inline constexpr std::size_t kCsiRows = kSubcarriers * kAntennas;

/// Received power before the card's gain, dBm; nullopt when all RSSI are 0.
std::optional<double> total_rss_dbm(const CsiRecord& record);

/// What raw CSI is multiplied by to be in units of sqrt(SNR).
///   returns  nullopt where that is undefined: CSI all zero, or RSSI all zero
///   cost     some 50 ns, no allocation
std::optional<double> scale_factor(const CsiRecord& record);

/// Scaled CSI of one record, each number rounded once from double.
///   requires  out of 90 * T numbers, T at least record.ntx
///   returns   false, and `out` untouched, where undefined
///   cost      some 120 ns at 3x1, no allocation
bool scale_csi(const CsiRecord& record, CsiMatrix out);

/// The same with the spatial mapping Q of an Intel 5300 transmitter removed: per subcarrier and antenna
/// h * conj(Q)^T. Right only when the sender is one, or uses the same Q; with one stream it is scale_csi().
bool scale_csi_without_mapping(const CsiRecord& record, CsiMatrix out);

}  // namespace csipose
