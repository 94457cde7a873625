#include "proto/intel5300.h"

#include <algorithm>
#include <cassert>
#include <cstring>

namespace csipose {
namespace {

constexpr std::size_t kLargestPayload = payload_bytes(kAntennas, kMaxStreams);
constexpr std::size_t kChainStride = kMaxStreams * 2;  // int8 per antenna in CsiRecord::csi

/// First bit of subcarrier k, chain j in a payload of N = nrx * ntx entries per subcarrier.
constexpr std::size_t first_bit(std::size_t k, std::size_t j, std::size_t nrx, std::size_t ntx) {
  return k * (16 * nrx * ntx + 3) + 3 + 16 * j * ntx;
}

/// Stores `Chains` chains of Ntx entries each, which lie in `entries` from its low end, onto their antennas.
template <std::size_t Chains, std::size_t Ntx>
void place(std::uint64_t entries, const std::uint8_t* antenna, std::int8_t* csi) {
  for (std::size_t j = 0; j < Chains; ++j, entries >>= 16 * Ntx) {
    std::uint8_t bytes[8];
    store_le(bytes, entries);
    std::memcpy(csi + antenna[j] * kChainStride, bytes, 2 * Ntx);
  }
}

/// A 64-bit load shifted by at most 7 holds 3 entries: all chains of one stream, or one chain of two or three. The sizes are
/// template arguments because constant shifts and strides make this several times as fast.
template <std::size_t Nrx, std::size_t Ntx>
bool unpack(const std::uint8_t* payload, const std::array<std::uint8_t, kAntennas>& antenna,
            std::int8_t* csi) {
  constexpr std::size_t kChains = Ntx == 1 ? Nrx : 1;
  constexpr std::uint64_t kMask = (std::uint64_t{1} << (16 * kChains * Ntx)) - 1;
  std::uint64_t any = 0;
  for (std::size_t k = 0; k < kSubcarriers; ++k, csi += kAntennas * kChainStride)
    for (std::size_t j = 0; j < Nrx; j += kChains) {
      const std::size_t bit = first_bit(k, j, Nrx, Ntx);
      const std::uint64_t entries = (load_le<std::uint64_t>(payload + bit / 8) >> (bit % 8)) & kMask;
      place<kChains, Ntx>(entries, antenna.data() + j, csi);
      any |= entries;
    }
  return any != 0;
}

using Unpack = bool (*)(const std::uint8_t*, const std::array<std::uint8_t, kAntennas>&, std::int8_t*);
constexpr Unpack kUnpack[kAntennas][kMaxStreams] = {{unpack<1, 1>, unpack<1, 2>, unpack<1, 3>},
                                                    {unpack<2, 1>, unpack<2, 2>, unpack<2, 3>},
                                                    {unpack<3, 1>, unpack<3, 2>, unpack<3, 3>}};

void read_header(const std::uint8_t* p, CsiRecord& out) {
  out.timestamp_low = load_le<std::uint32_t>(p);
  out.bfee_count = load_le<std::uint16_t>(p + 4);
  out.nrx = p[8];
  out.ntx = p[9];
  std::copy_n(p + 10, kAntennas, out.rssi.begin());
  out.noise_dbm = static_cast<std::int8_t>(p[13]);
  out.agc_db = p[14];
  out.antenna_sel = p[15];
  out.payload_length = load_le<std::uint16_t>(p + 16);
  out.rate = load_le<std::uint16_t>(p + 18);
  out.perm = permutation(out.antenna_sel);
  out.perm_valid = is_permutation(out.perm, out.nrx);
  out.all_zero_rssi = out.rssi == std::array<std::uint8_t, kAntennas>{};
}

/// The inverse of read_header(), for a record's sizes as they are and a payload length derived from them.
void write_header(const CsiRecord& record, std::uint8_t* p) {
  store_le(p, record.timestamp_low);
  store_le(p + 4, record.bfee_count);
  p[8] = record.nrx;
  p[9] = record.ntx;
  std::copy(record.rssi.begin(), record.rssi.end(), p + 10);
  p[13] = static_cast<std::uint8_t>(record.noise_dbm);
  p[14] = record.agc_db;
  p[15] = record.antenna_sel;
  store_le(p + 16, static_cast<std::uint16_t>(payload_bytes(record.nrx, record.ntx)));
  store_le(p + 18, record.rate);
}

/// Which antenna each chain goes to; chain order where nobody can tell.
std::array<std::uint8_t, kAntennas> antenna_of_chain(std::uint8_t antenna_sel, std::size_t nrx) {
  const auto perm = permutation(antenna_sel);
  return is_permutation(perm, nrx) ? perm : std::array<std::uint8_t, kAntennas>{0, 1, 2};
}

void put_byte(std::uint8_t* payload, std::size_t bit, std::int8_t value) {
  const unsigned shifted = static_cast<std::uint8_t>(value) << (bit % 8);
  payload[bit / 8] = static_cast<std::uint8_t>(payload[bit / 8] | shifted);
  payload[bit / 8 + 1] = static_cast<std::uint8_t>(payload[bit / 8 + 1] | shifted >> 8);
}

}  // namespace

std::optional<RecordFault> decode_bfee(ByteView body, CsiRecord& out) {
  if (body.size() < kBfeeHeaderBytes) return RecordFault::short_record;
  const std::size_t nrx = body[8], ntx = body[9], length = load_le<std::uint16_t>(body.data() + 16);
  if (nrx < 1 || nrx > kAntennas || ntx < 1 || ntx > kMaxStreams) return RecordFault::bad_dims;
  if (length != payload_bytes(nrx, ntx)) return RecordFault::bad_len;
  if (body.size() < kBfeeHeaderBytes + length) return RecordFault::payload_short;

  read_header(body.data(), out);
  // 64-bit loads reach past the payload's last byte, so it is copied to where there is room behind it.
  std::array<std::uint8_t, kLargestPayload + sizeof(std::uint64_t)> payload;
  std::memcpy(payload.data(), body.data() + kBfeeHeaderBytes, length);
  std::memset(payload.data() + length, 0, sizeof(std::uint64_t));
  out.csi.fill(0);
  out.all_zero_csi =
      !kUnpack[nrx - 1][ntx - 1](payload.data(), antenna_of_chain(out.antenna_sel, nrx), out.csi.data());
  return std::nullopt;
}

void count_decoded(RecordCounts& counts, const std::optional<RecordFault>& refusal, const CsiRecord& record) {
  if (refusal) {
    ++counts[*refusal];
    return;
  }
  counts[RecordFault::perm_invalid] += !record.perm_valid;
  counts[RecordFault::all_zero_csi] += record.all_zero_csi;
  counts[RecordFault::all_zero_rssi] += record.all_zero_rssi;
}

void append_bfee_record(const CsiRecord& record, std::vector<std::uint8_t>& out) {
  const std::size_t nrx = record.nrx, ntx = record.ntx;
  assert(nrx >= 1 && nrx <= kAntennas && ntx >= 1 && ntx <= kMaxStreams);
  const std::size_t body_bytes = kBfeeHeaderBytes + payload_bytes(nrx, ntx), start = out.size();
  out.resize(start + kRecordHeaderBytes + body_bytes);
  std::uint8_t* p = out.data() + start;
  store_be16(p, static_cast<std::uint16_t>(1 + body_bytes));
  p[2] = kCsiCode;
  write_header(record, p + kRecordHeaderBytes);

  std::uint8_t* payload = p + kRecordHeaderBytes + kBfeeHeaderBytes;
  const auto antenna = antenna_of_chain(record.antenna_sel, nrx);
  for (std::size_t k = 0; k < kSubcarriers; ++k)
    for (std::size_t j = 0; j < nrx; ++j)
      for (std::size_t i = 0; i < 2 * ntx; ++i)
        put_byte(payload, first_bit(k, j, nrx, ntx) + 8 * i,
                 record.csi[CsiRecord::index(k, antenna[j], 0) + i]);
}

std::array<std::uint8_t, kAntennas> permutation(std::uint8_t antenna_sel) {
  const auto antenna = [antenna_sel](int chain) {
    return static_cast<std::uint8_t>((antenna_sel >> (2 * chain)) & 3);
  };
  return {antenna(0), antenna(1), antenna(2)};
}

bool is_permutation(const std::array<std::uint8_t, kAntennas>& perm, std::size_t nrx) {
  unsigned seen = 0;
  for (std::size_t j = 0; j < nrx; ++j) {
    const unsigned antenna = 1u << perm[j];
    if (perm[j] >= kAntennas || (seen & antenna) != 0) return false;
    seen |= antenna;
  }
  return true;
}

const std::array<std::int8_t, kSubcarriers>& subcarrier_indices(bool is_40mhz) {
  static constexpr std::array<std::int8_t, kSubcarriers> k20MHz = {
      -28, -26, -24, -22, -20, -18, -16, -14, -12, -10, -8, -6, -4, -2, -1,
      1,   3,   5,   7,   9,   11,  13,  15,  17,  19,  21, 23, 25, 27, 28};
  static constexpr std::array<std::int8_t, kSubcarriers> k40MHz = {
      -58, -54, -50, -46, -42, -38, -34, -30, -26, -22, -18, -14, -10, -6, -2,
      2,   6,   10,  14,  18,  22,  26,  30,  34,  38,  42,  46,  50,  54, 58};
  return is_40mhz ? k40MHz : k20MHz;
}

RateFields rate_fields(std::uint16_t rate) {
  const auto bit = [rate](int n) { return ((rate >> n) & 1) != 0; };
  const unsigned streams = ((rate >> 3) & 3) + 1u;
  return {.mcs = static_cast<std::uint8_t>(8 * (streams - 1) + (rate & 7)),
          .streams = static_cast<std::uint8_t>(streams),
          .ht = bit(8),
          .cck = bit(9),
          .greenfield = bit(10),
          .is_40mhz = bit(11),
          .short_guard = bit(13)};
}

}  // namespace csipose
