// proto/intel5300.h - the body of a 0xBB record: one CSI matrix of an Intel 5300, read and written.
//
//   byte  0  1  2  3 | 4  5 | 6  7 | 8 | 9 | 10 11 12 | 13 | 14 | 15 | 16 17 | 18 19 | 20 ...
//         timestamp  | count| res. |Nrx|Ntx| rssi abc |nois|agc |sel | len   | rate  | payload, len bytes
//
// All little-endian. The payload is packed by bits, least significant first: for each of 30 subcarriers 3
// bits of 0, then for each chain, for each stream, 8 bits real and 8 bits imaginary, signed. Chain j belongs
// to antenna (sel >> 2j) & 3, which changes from record to record; we give antennas, never chains.
// Sources: linux-80211n-csitool-supplementary matlab/read_bfee.c; measured on its sample and on csiread's
// recordings.
// Not here: framing (record_stream.h), absolute scale (capture/scale.h).
#pragma once

#include <array>
#include <cstdint>
#include <optional>
#include <vector>

#include "proto/bytes.h"
#include "proto/csi_record.h"
#include "proto/record_stream.h"

namespace csipose {

inline constexpr std::size_t kBfeeHeaderBytes = 20;
constexpr std::size_t payload_bytes(std::size_t nrx, std::size_t ntx) { return 60 * nrx * ntx + 12; }

/// Decodes a 0xBB body; bytes behind the payload are ignored.
///   returns  nullopt when `out` is filled; else why not (short_record, bad_dims, bad_len, payload_short),
///   and
///            `out` is not to be read
///   cost     some 80 ns at 3x1, no allocation
std::optional<RecordFault> decode_bfee(ByteView body, CsiRecord& out);

/// Counts into the stream's counters what decode_bfee() found: its refusal, or the flags of a good record.
void count_decoded(RecordCounts& counts, const std::optional<RecordFault>& refusal, const CsiRecord& record);

/// Exact inverse: appends the framed record (length, code, body) whose decoding gives `record` again.
/// Requires nrx and ntx in 1..3; payload_length and the flags are derived, not read. With perm_valid = false
/// csi is taken in chain order.
void append_bfee_record(const CsiRecord& record, std::vector<std::uint8_t>& out);

/// perm[j] = (antenna_sel >> 2j) & 3, and whether its first nrx entries are distinct antennas.
std::array<std::uint8_t, kAntennas> permutation(std::uint8_t antenna_sel);
bool is_permutation(const std::array<std::uint8_t, kAntennas>& perm, std::size_t nrx);

/// Subcarrier numbers, spacing 312.5 kHz: every second at 20 MHz (with -1 and 28 beside the even ones), every
/// fourth at 40 MHz. Source: IEEE 802.11n-2009 table 7-25f, grouping Ng = 2 and 4.
const std::array<std::int8_t, kSubcarriers>& subcarrier_indices(bool is_40mhz);

/// The fields of `rate` (low 14 bits of the driver's rate_n_flags).
struct RateFields {
  std::uint8_t mcs;      ///< HT MCS index, 0..31
  std::uint8_t streams;  ///< 1..4
  bool ht, cck, greenfield, is_40mhz, short_guard;
};
RateFields rate_fields(std::uint16_t rate);

}  // namespace csipose
