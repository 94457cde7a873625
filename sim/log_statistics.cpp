#include "sim/log_statistics.h"

#include <fmt/core.h>

#include <algorithm>
#include <cmath>
#include <complex>
#include <limits>

#include "proto/intel5300.h"
#include "proto/result.h"
#include "sim/band.h"
#include "sim/geometry.h"

namespace csipose::sim {
namespace {
using Complex = std::complex<double>;
constexpr std::size_t kMiddle = 14;  // subcarrier -1

std::vector<CsiRecord> usable_records(ByteView log) {
  std::vector<CsiRecord> records;
  RecordStream stream(log, RecordStream::Policy::resynchronising);
  CsiRecord record;
  while (const auto raw = stream.next())
    if (raw->code == kCsiCode && !decode_bfee(raw->body, record) && record.usable())
      records.push_back(record);
  return records;
}

Complex at(const CsiRecord& record, std::size_t k, std::size_t antenna) {
  return Complex(record.at(k, antenna, 0));
}

/// From the products of neighbours two tones apart: no unwrapping, weighted by power.
double delay_ns_of(const CsiRecord& record) {
  const auto& tones = subcarrier_indices(false);
  Complex turn = 0;
  for (std::size_t a = 0; a < kAntennas; ++a)
    for (std::size_t k = 0; k + 1 < kSubcarriers; ++k)
      if (tones[k + 1] - tones[k] == 2) turn += at(record, k + 1, a) * std::conj(at(record, k, a));
  return -std::arg(turn) / (2 * kPi * 2 * kToneSpacing_hz) * 1e9;
}

double received_dbm_of(const CsiRecord& record) {
  double sum = 0;
  for (const std::uint8_t rssi : record.rssi)
    if (rssi != 0) sum += std::pow(10.0, rssi / 10.0);
  return 10 * std::log10(sum) - 44 - record.agc_db;  // csitool's relation
}

double correlation(const std::vector<double>& x, const std::vector<double>& y) {
  const Spread a = spread_of(x), b = spread_of(y);
  if (a.deviation == 0 || b.deviation == 0) return std::numeric_limits<double>::quiet_NaN();
  double sum = 0;
  for (std::size_t i = 0; i < x.size(); ++i) sum += (x[i] - a.mean) * (y[i] - b.mean);
  return sum / static_cast<double>(x.size()) / (a.deviation * b.deviation);
}

double median(std::vector<double> values) {
  std::nth_element(values.begin(), values.begin() + static_cast<std::ptrdiff_t>(values.size() / 2),
                   values.end());
  return values[values.size() / 2];
}

void add_matrix(const CsiRecord& record, std::vector<double>& amplitudes, std::vector<double>& powers) {
  double power = 0;
  for (std::size_t k = 0; k < kSubcarriers; ++k)
    for (std::size_t a = 0; a < kAntennas; ++a) {
      amplitudes.push_back(std::abs(at(record, k, a)));
      power += std::norm(at(record, k, a)) / kSubcarriers;
    }
  powers.push_back(10 * std::log10(power));
}

}  // namespace

Spread spread_of(std::vector<double> values) {
  Spread spread;
  if (values.empty()) return spread;
  const double n = static_cast<double>(values.size());
  for (const double x : values) spread.mean += x / n;
  for (const double x : values) spread.deviation += (x - spread.mean) * (x - spread.mean) / n;
  spread.deviation = std::sqrt(spread.deviation);
  std::sort(values.begin(), values.end());
  spread.low = values[static_cast<std::size_t>(0.05 * (n - 1))];
  spread.high = values[static_cast<std::size_t>(0.95 * (n - 1))];
  return spread;
}

LogStatistics log_statistics(ByteView log, const std::string& name) {
  const std::vector<CsiRecord> records = usable_records(log);
  if (records.size() < 2)
    throw SetupError(
        ExitStatus::bad_data,
        fmt::format("{} has {} usable CSI records; statistics need two: is it a csitool log of three "
                    "receive chains?",
                    name, records.size()));
  LogStatistics s;
  s.records = records.size();
  std::vector<double> amplitudes, powers, delays, delay_steps, agc, rssi, received, steps;
  Complex carrier = 0, between = 0;
  for (std::size_t i = 0; i < records.size(); ++i) {
    const CsiRecord& record = records[i];
    add_matrix(record, amplitudes, powers);
    if (!record.is_40mhz()) {
      delays.push_back(delay_ns_of(record));
      if (delays.size() > 1) delay_steps.push_back(std::abs(delays.back() - delays[delays.size() - 2]));
    }
    carrier += std::polar(1.0, std::arg(at(record, kMiddle, 0)));
    between += std::polar(1.0, std::arg(at(record, kMiddle, 1) * std::conj(at(record, kMiddle, 0))));
    agc.push_back(record.agc_db);
    for (const std::uint8_t value : record.rssi) rssi.push_back(value);
    received.push_back(received_dbm_of(record));
    if (i > 0) steps.push_back((record.timestamp_low - records[i - 1].timestamp_low) / 1e3);
  }
  const double n = static_cast<double>(records.size());
  s.amplitude = spread_of(amplitudes);
  s.csi_power_db = spread_of(powers);
  s.delay_ns = spread_of(delays);
  if (!delay_steps.empty()) s.median_delay_step_ns = median(delay_steps);
  s.carrier_concentration = std::abs(carrier) / n;
  s.antenna_concentration = std::abs(between) / n;
  s.agc_db = spread_of(agc);
  s.rssi_db = spread_of(rssi);
  s.received_dbm = spread_of(received);
  s.agc_rssi_correlation = correlation(agc, received);
  s.step_ms = spread_of(steps);
  double span_ms = 0;
  for (const double step : steps) span_ms += step;
  s.missing_share = std::max(0.0, 1 - n / (span_ms / median(steps) + 1));
  return s;
}

}  // namespace csipose::sim
