#include "capture/scale.h"

#include <algorithm>
#include <cassert>
#include <cmath>
#include <cstring>
#include <numbers>

namespace csipose {
namespace {

constexpr double kGainOffsetDb = 44;   // of the card's RSSI against dBm, from get_total_rss.m
constexpr int kAssumedNoiseDbm = -92;  // where the card says that it does not know
constexpr std::int8_t kUnknownNoise = -127;

/// 10^(dB/10) for whole decibels: all that a record holds. pow() three times a record would cost more than
/// the decoding.
class PowerRatios {
 public:
  PowerRatios() {
    for (int db = kLowest; db <= kHighest; ++db) ratio_[db - kLowest] = std::pow(10.0, db / 10.0);
  }
  double operator()(int db) const { return ratio_[db - kLowest]; }

 private:
  static constexpr int kLowest = -300, kHighest = 255;  // -44 - agc reaches down to -299
  std::array<double, kHighest - kLowest + 1> ratio_{};
};
const PowerRatios power_ratio;

/// Sum of 10^(rssi/10) over antennas in use.
double rssi_sum(const CsiRecord& record) {
  double sum = 0;
  for (const std::uint8_t rssi : record.rssi)
    if (rssi != 0) sum += power_ratio(rssi);
  return sum;
}

// The two loops over a matrix, for any processor and for wider ones: the compiler's own vectors, two and three times as fast.
// Neither loop adds in floating point, so all give the same bits.
#define CSIPOSE_INLINE inline __attribute__((always_inline))
CSIPOSE_INLINE std::int32_t power_of(std::span<const std::int8_t> counts) {
  std::int32_t power = 0;
  for (const std::int8_t count : counts) power += count * count;
  return power;
}
CSIPOSE_INLINE void multiply(std::span<const std::int8_t> counts, double factor, float* out) {
  for (std::size_t i = 0; i < counts.size(); ++i) out[i] = static_cast<float>(counts[i] * factor);
}

struct Loops {
  std::int32_t (*power)(std::span<const std::int8_t> counts);  ///< sum of c^2: at most 540 * 128^2, exact
  void (*product)(std::span<const std::int8_t> counts, double factor, float* out);  ///< each rounded once
};
Loops plain_loops() {
  return {
      [](std::span<const std::int8_t> counts) { return power_of(counts); },
      [](std::span<const std::int8_t> counts, double factor, float* out) { multiply(counts, factor, out); }};
}
#if defined(__x86_64__)
__attribute__((target("avx2"))) std::int32_t power_avx2(std::span<const std::int8_t> counts) {
  return power_of(counts);
}
__attribute__((target("avx2"))) void product_avx2(std::span<const std::int8_t> counts, double factor,
                                                  float* out) {
  multiply(counts, factor, out);
}
#define CSIPOSE_AVX512 __attribute__((target("avx512f,avx512bw,avx512dq,avx512vl")))
CSIPOSE_AVX512 std::int32_t power_avx512(std::span<const std::int8_t> counts) { return power_of(counts); }
CSIPOSE_AVX512 void product_avx512(std::span<const std::int8_t> counts, double factor, float* out) {
  multiply(counts, factor, out);
}
Loops best_loops() {
  if (__builtin_cpu_supports("avx512bw") && __builtin_cpu_supports("avx512dq") &&
      __builtin_cpu_supports("avx512vl"))
    return {power_avx512, product_avx512};
  if (__builtin_cpu_supports("avx2")) return {power_avx2, product_avx2};
  return plain_loops();
}
#else
Loops best_loops() { return plain_loops(); }
#endif
const Loops loops = best_loops();

/// The first `streams` streams of each row of three, close together: what the loops over them can be fast on.
using Counts = std::array<std::int8_t, kCsiRows * kMaxStreams * 2>;
template <std::size_t Streams>
std::span<const std::int8_t> gather(const CsiRecord& record, Counts& counts) {
  for (std::size_t row = 0; row < kCsiRows; ++row)
    std::memcpy(counts.data() + row * Streams * 2, record.csi.data() + row * kMaxStreams * 2, Streams * 2);
  return {counts.data(), kCsiRows * Streams * 2};
}
std::span<const std::int8_t> gather(const CsiRecord& record, std::size_t streams, Counts& counts) {
  if (streams == 1) return gather<1>(record, counts);
  return streams == 2 ? gather<2>(record, counts) : gather<3>(record, counts);
}

/// Gain of Ntx streams sharing one transmitter's power. Intel's 4.5 dB for three is not 10 log 3, and is
/// meant.
double stream_gain(int ntx) {
  static const std::array<double, kMaxStreams> kGain = {1, std::numbers::sqrt2, std::pow(10.0, 4.5 / 20)};
  return kGain[ntx - 1];
}

/// The mapping's conjugate transpose, [from][to].
using Unmapping = std::array<std::array<std::complex<double>, kMaxStreams>, kMaxStreams>;

Unmapping hermitian(const Unmapping& q, std::size_t streams) {
  Unmapping result{};
  for (std::size_t i = 0; i < streams; ++i)
    for (std::size_t j = 0; j < streams; ++j) result[i][j] = std::conj(q[j][i]);
  return result;
}

Unmapping two_streams(bool is_40mhz) {
  const double a = 1 / std::numbers::sqrt2;
  const std::complex<double> j(0, a);
  return hermitian(is_40mhz ? Unmapping{{{a, j}, {j, a}}} : Unmapping{{{a, a}, {a, -a}}}, 2);
}

Unmapping three_streams(bool is_40mhz) {
  // Turns of a full circle, remove_sm.m.
  static constexpr double k20MHz[3][3] = {
      {-1. / 16, -33. / 80, 3. / 80}, {23. / 80, 13. / 48, 13. / 240}, {-13. / 80, 37. / 240, 13. / 48}};
  static constexpr double k40MHz[3][3] = {
      {-1. / 16, -13. / 80, 23. / 80}, {-37. / 80, -11. / 48, -107. / 240}, {7. / 80, -83. / 240, -11. / 48}};
  Unmapping q{};
  for (std::size_t i = 0; i < 3; ++i)
    for (std::size_t j = 0; j < 3; ++j)
      q[i][j] =
          std::polar(1 / std::numbers::sqrt3, 2 * std::numbers::pi * (is_40mhz ? k40MHz : k20MHz)[i][j]);
  return hermitian(q, 3);
}

const Unmapping& unmapping(std::size_t ntx, bool is_40mhz) {
  static const std::array<Unmapping, 4> kAll = {two_streams(false), two_streams(true), three_streams(false),
                                                three_streams(true)};
  return kAll[2 * (ntx - 2) + (is_40mhz ? 1 : 0)];
}

std::optional<double> factor_at_power(const CsiRecord& record, std::int32_t power) {
  const double rssi = rssi_sum(record);
  if (rssi == 0 || power == 0) return std::nullopt;
  const double received_mw = rssi * power_ratio(-static_cast<int>(kGainOffsetDb) - record.agc_db);
  const double scale = received_mw / (static_cast<double>(power) / kSubcarriers);
  const double thermal = power_ratio(record.noise_dbm == kUnknownNoise ? kAssumedNoiseDbm : record.noise_dbm);
  const double quantisation = scale * record.nrx * record.ntx;  // an error of power 1 in each entry
  return std::sqrt(scale / (thermal + quantisation)) * stream_gain(record.ntx);
}

}  // namespace

std::optional<double> total_rss_dbm(const CsiRecord& record) {
  const double sum = rssi_sum(record);
  if (sum == 0) return std::nullopt;
  return 10 * std::log10(sum) - kGainOffsetDb - record.agc_db;
}

std::optional<double> scale_factor(const CsiRecord& record) {
  return factor_at_power(record, loops.power(record.csi));
}

bool scale_csi(const CsiRecord& record, CsiMatrix out) {
  assert(out.size() >= kCsiRows * record.ntx && out.size() % kCsiRows == 0);
  Counts memory;
  const std::span<const std::int8_t> counts = gather(record, out.size() / kCsiRows, memory);
  const std::optional<double> factor = factor_at_power(record, loops.power(counts));
  if (!factor) return false;
  // std::complex is an array of two by its standard
  loops.product(counts, *factor, reinterpret_cast<float*>(out.data()));
  return true;
}

bool scale_csi_without_mapping(const CsiRecord& record, CsiMatrix out) {
  assert(out.size() >= kCsiRows * record.ntx && out.size() % kCsiRows == 0);
  if (record.ntx == 1) return scale_csi(record, out);
  const std::optional<double> factor = scale_factor(record);
  if (!factor) return false;
  const Unmapping& m = unmapping(record.ntx, record.is_40mhz());
  const std::size_t streams = out.size() / kCsiRows;
  std::fill(out.begin(), out.end(), 0);
  for (std::size_t row = 0; row < kCsiRows; ++row)
    for (std::size_t to = 0; to < record.ntx; ++to) {
      std::complex<double> sum = 0;
      for (std::size_t from = 0; from < record.ntx; ++from) {
        const std::size_t i = 2 * (row * kMaxStreams + from);
        sum += std::complex<double>(record.csi[i], record.csi[i + 1]) * m[from][to];
      }
      out[row * streams + to] = std::complex<float>(sum * *factor);
    }
  return true;
}

}  // namespace csipose
