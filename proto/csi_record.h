// proto/csi_record.h - one decoded Intel 5300 CSI notification (record code 0xBB), in antenna order.
//
// Header fields as in the csitool's iwl_connector format; the codec is intel5300.h.
#pragma once

#include <array>
#include <complex>
#include <cstddef>
#include <cstdint>

#include "proto/shape.h"

namespace csipose {

struct CsiRecord {
  std::uint32_t timestamp_low = 0;  ///< us, low half of the NIC's 1 MHz TSF; wraps every 4294.967296 s
  std::uint16_t bfee_count = 0;     ///< driver's counter of CSI notifications
  std::uint8_t nrx = 0, ntx = 0;    ///< receive chains and space-time streams in this matrix, 1..3
  std::array<std::uint8_t, kAntennas>
      rssi{};                 ///< dB above an internal reference, physical antenna A, B, C; 0 = not used
  std::int8_t noise_dbm = 0;  ///< -127 = unknown
  std::uint8_t agc_db = 0;
  std::uint8_t antenna_sel = 0;  ///< as sent; perm is derived from it
  std::uint16_t payload_length = 0;
  std::uint16_t rate = 0;                      ///< low 14 bits of rate_n_flags
  std::array<std::uint8_t, kAntennas> perm{};  ///< chain j belongs to physical antenna perm[j] (A=0)
  bool perm_valid = false;  ///< first nrx entries distinct and below 3; if not, csi stays in chain order
  bool all_zero_csi = false;
  bool all_zero_rssi = false;

  /// [subcarrier][antenna A,B,C][stream][re, im]; absent antennas and streams are 0.
  std::array<std::int8_t, kSubcarriers * kAntennas * kMaxStreams * 2> csi{};

  static constexpr std::size_t index(std::size_t k, std::size_t antenna, std::size_t stream) {
    return ((k * kAntennas + antenna) * kMaxStreams + stream) * 2;
  }
  std::complex<float> at(std::size_t k, std::size_t antenna, std::size_t stream) const {
    const std::size_t i = index(k, antenna, stream);
    return {static_cast<float>(csi[i]), static_cast<float>(csi[i + 1])};
  }
  bool is_40mhz() const { return (rate & 0x800) != 0; }
  /// Fit for a window: three chains, a valid permutation and CSI that is not all zero.
  bool usable() const { return nrx == 3 && perm_valid && !all_zero_csi; }
};

}  // namespace csipose
