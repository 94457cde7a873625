#include "sim/radio.h"

#include <algorithm>
#include <cassert>
#include <cmath>

#include "proto/intel5300.h"
#include "sim/geometry.h"

namespace csipose::sim {
namespace {

constexpr std::uint32_t kPacketsPerFrame = 20;  // of the counter's frame word; the window's length
constexpr std::uint64_t kInstallations = 5300;  // seed of all cards that stay powered
constexpr double kThermalNoise_dbm = -92;       // what the csitool assumes where the card reports none
constexpr double kRssiOffset_db = 44;           // csitool's get_total_rss: dBm = rssi - 44 - agc
constexpr double kAgcTarget_dbm = -3;
constexpr std::uint16_t kRateHt20 = 0x101, kRateHt40 = 0x901;  // one stream, HT, MCS 1
constexpr std::int8_t kNoiseUnknown_dbm = -127;                // as always in monitor mode
constexpr std::array<std::uint8_t, 6> kAntennaSel{36, 24, 9, 18, 33, 6};

// Packet losses, Gilbert (1960) and Elliott (1963): two states, each with a loss of its own.
constexpr double kLossGood = 0.005, kLossBad = 0.30, kBadShare = 0.02, kMeanBad_s = 0.020;

double db(double power) { return 10 * std::log10(power); }
double power(double db_value) { return std::pow(10, db_value / 10); }
double voltage(double db_value) { return std::pow(10, db_value / 20); }
double nearest(double x) { return std::floor(x + 0.5); }

double mean_power(const ReceiverChannel& h, std::size_t antenna) {
  double sum = 0;
  for (const auto& tone : h) sum += std::norm(tone[antenna]);
  return sum / kSubcarriers;
}

/// Ripple of one period over the band with random phase; the outer two tones at each edge lie lower.
std::array<double, kSubcarriers> draw_passband(CounterRng& rng) {
  const double ripple_db = rng.uniform(0, 1), ripple_phase = rng.uniform(0, 2 * kPi);
  const double edge_db = rng.uniform(2, 5);
  std::array<double, kSubcarriers> passband{};
  for (std::size_t k = 0; k < kSubcarriers; ++k) {
    const std::size_t from_edge = std::min(k, kSubcarriers - 1 - k);
    const double roll_off_db = from_edge == 0 ? edge_db : from_edge == 1 ? edge_db / 2 : 0;
    const double turn = 2 * kPi * static_cast<double>(k) / kSubcarriers;
    passband[k] = voltage(ripple_db * std::cos(turn + ripple_phase) - roll_off_db);
  }
  return passband;
}

/// Good links jitter by 8 ns, weak ones by 29 ns (recorded: 7-9 and 25-33); between -50 and -70 dBm we
/// interpolate.
double delay_jitter_sigma_s(double total_dbm) {
  const double weakness = std::clamp((-50 - total_dbm) / 20, 0.0, 1.0);
  return (8 + 21 * weakness) * 1e-9;
}

std::int8_t quantise(double x) { return static_cast<std::int8_t>(std::clamp(nearest(x), -128.0, 127.0)); }

std::uint8_t antenna_sel_of(const std::array<std::uint8_t, kAntennas>& perm) {
  return static_cast<std::uint8_t>(perm[0] | perm[1] << 2 | perm[2] << 4);
}

}  // namespace

std::span<const NamedImpairment> named_impairments() {
  static constexpr NamedImpairment kAll[] = {{"carrier_phase", &Impairments::carrier_phase},
                                             {"detection_delay", &Impairments::detection_delay},
                                             {"delay_jitter", &Impairments::delay_jitter},
                                             {"branch_gain", &Impairments::branch_gain},
                                             {"branch_phase", &Impairments::branch_phase},
                                             {"passband", &Impairments::passband},
                                             {"thermal_noise", &Impairments::thermal_noise},
                                             {"converter_noise", &Impairments::converter_noise},
                                             {"power_jitter", &Impairments::power_jitter},
                                             {"antenna_order", &Impairments::antenna_order},
                                             {"losses", &Impairments::losses},
                                             {"channel_access", &Impairments::channel_access},
                                             {"own_clock", &Impairments::own_clock}};
  return kAll;
}

Impairments impairments(ImpairmentLevel level) {
  Impairments on;
  if (level == ImpairmentLevel::none) return on;
  on.carrier_phase = on.detection_delay = on.delay_jitter = on.converter_noise = on.own_clock = true;
  if (level == ImpairmentLevel::mild) return on;
  on.branch_gain = on.branch_phase = on.passband = on.thermal_noise = on.power_jitter = true;
  on.antenna_order = on.losses = on.channel_access = true;
  return on;
}

CounterRng PacketId::rng(std::size_t receiver) const {
  const auto sub = static_cast<std::uint16_t>(receiver * 32 + number % kPacketsPerFrame);
  return {seed, Purpose::impair_packet, sub, clip, number / kPacketsPerFrame};
}

Nic draw_nic(const Impairments& on, std::uint64_t seed, std::uint32_t clip, std::size_t receiver) {
  if (on.power_up != 0) seed = kInstallations, clip = on.power_up;
  CounterRng sender(seed, Purpose::impair_nic, kReceivers, clip, 0);
  CounterRng rng(seed, Purpose::impair_nic, static_cast<std::uint16_t>(receiver), clip, 0);
  Nic nic;
  nic.transmit_power_dbm = sender.uniform(10, 17);
  nic.csi_power_db = rng.uniform(30, 36);
  const double delay_s = rng.uniform(172e-9, 214e-9);
  if (on.detection_delay) nic.mean_delay_s = delay_s;
  const double zero_us = rng.uniform(0, 0x1p32), skew = rng.uniform(-20e-6, 20e-6);
  nic.first_count = static_cast<std::uint16_t>(rng.index(65536));
  if (on.own_clock) nic.clock_zero_us = zero_us, nic.clock_rate = 1 + skew;
  if (!on.own_clock) nic.first_count = 0;
  for (std::size_t a = 0; a < kAntennas; ++a) {
    const double gain_db = rng.uniform(-3, 3), phase_rad = rng.uniform(-kPi, kPi);
    const auto passband = draw_passband(rng);
    if (on.branch_gain) nic.gain[a] = voltage(gain_db);
    if (on.branch_phase) nic.phase_rad[a] = phase_rad;
    if (on.passband) nic.passband[a] = passband;
  }
  return nic;
}

double access_delay_s(const Impairments& on, PacketId id) {
  if (!on.channel_access) return 0;
  CounterRng rng = id.rng(kReceivers);
  const double usual_s = 60e-6 * rng.exponential();
  return usual_s + (rng.chance(0.05) ? rng.uniform(0.3e-3, 2e-3) : 0);
}

Levels received_levels(const Nic& nic, const ReceiverChannel& h) {
  Levels levels;
  double sum = 0;
  for (std::size_t a = 0; a < kAntennas; ++a) {
    const double received = mean_power(h, a) * nic.gain[a] * nic.gain[a];
    levels.power_dbm[a] = nic.transmit_power_dbm + db(received);
    sum += received;
  }
  assert(sum > 0);
  levels.total_dbm = nic.transmit_power_dbm + db(sum);
  return levels;
}

std::uint8_t agc_for(double total_dbm) {
  return static_cast<std::uint8_t>(std::clamp(nearest(kAgcTarget_dbm - total_dbm), 0.0, 63.0));
}

std::uint8_t rssi_for(double power_dbm, std::uint8_t agc_db) {
  return static_cast<std::uint8_t>(std::clamp(nearest(power_dbm + kRssiOffset_db + agc_db), 0.0, 255.0));
}

ReceiverChannel distort(const Nic& nic, const PacketTrouble& trouble, const Band& band,
                        const ReceiverChannel& h) {
  std::array<std::complex<double>, kAntennas> branch;
  for (std::size_t a = 0; a < kAntennas; ++a)
    branch[a] = std::polar(nic.gain[a], nic.phase_rad[a] + trouble.carrier_phase_rad);
  ReceiverChannel x;
  for (std::size_t k = 0; k < kSubcarriers; ++k) {
    const double slope_rad = -2 * kPi * band.offset_hz(k) * trouble.delay_s;
    const double half_turn_rad = band.is_40mhz && band.offset_hz(k) > 0 ? kPi / 2 : 0;
    const std::complex<double> turn = std::polar(1.0, slope_rad + half_turn_rad);
    for (std::size_t a = 0; a < kAntennas; ++a) x[k][a] = h[k][a] * branch[a] * (turn * nic.passband[a][k]);
  }
  return x;
}

double csi_scale(const Nic& nic, const PacketTrouble& trouble, const ReceiverChannel& x) {
  double sum = 0;
  for (std::size_t a = 0; a < kAntennas; ++a) sum += mean_power(x, a);
  return std::sqrt(power(nic.csi_power_db + trouble.power_offset_db) / sum);
}

Radio::Radio(const Impairments& on, const Band& band, const Nic& nic, std::size_t receiver, double rate_hz)
    : on_(on),
      band_(band),
      nic_(nic),
      receiver_(receiver),
      leave_bad_(std::min(1.0, 1 / (kMeanBad_s * rate_hz))),
      enter_bad_(leave_bad_ * kBadShare / (1 - kBadShare)),
      count_(nic.first_count) {}

PacketTrouble Radio::draw_trouble(CounterRng& rng, double total_dbm) const {
  const double phase_rad = rng.uniform(-kPi, kPi);
  const double jitter_s = delay_jitter_sigma_s(total_dbm) * rng.normal();
  const bool slips = rng.chance(0.005), early = rng.chance(0.5);
  const double power_db = rng.uniform(-0.65, 0.65);
  const auto perm = permutation(kAntennaSel[rng.index(kAntennaSel.size())]);
  PacketTrouble trouble;
  trouble.delay_s = nic_.mean_delay_s;
  if (on_.carrier_phase) trouble.carrier_phase_rad = phase_rad;
  if (on_.delay_jitter) trouble.delay_s += jitter_s + (slips ? (early ? -50e-9 : 50e-9) : 0);
  if (on_.power_jitter) trouble.power_offset_db = power_db;
  if (on_.antenna_order) trouble.perm = perm;
  return trouble;
}

bool Radio::lose(CounterRng& rng) {
  const double turn = rng.uniform(0, 1), loss = rng.uniform(0, 1);
  bad_ = bad_ ? turn >= leave_bad_ : turn < enter_bad_;
  return on_.losses && loss < (bad_ ? kLossBad : kLossGood);
}

std::uint8_t Radio::step_agc(double total_dbm) {
  // The loop follows only what has moved by more than 1 dB: gain that flickers between two steps would look
  // like motion.
  if (!have_agc_ || std::abs(kAgcTarget_dbm - total_dbm - agc_db_) > 1) agc_db_ = agc_for(total_dbm);
  have_agc_ = true;
  return agc_db_;
}

bool Radio::receive(PacketId id, double sent_s, const ReceiverChannel& h, CsiRecord& out) {
  CounterRng rng = id.rng(receiver_);
  if (lose(rng)) return false;
  record(draw_trouble(rng, received_levels(nic_, h).total_dbm), sent_s, h, rng, out);
  return true;
}

void Radio::record(const PacketTrouble& trouble, double sent_s, const ReceiverChannel& h, CounterRng& rng,
                   CsiRecord& out) {
  const Levels levels = received_levels(nic_, h);
  out = CsiRecord{};
  write_header(trouble, levels, step_agc(levels.total_dbm), sent_s, out);
  write_matrix(trouble, h, rng, out);
}

void Radio::write_header(const PacketTrouble& trouble, const Levels& levels, std::uint8_t agc_db,
                         double sent_s, CsiRecord& out) {
  const double card_us = nic_.clock_zero_us + nic_.clock_rate * sent_s * 1e6;
  out.timestamp_low = static_cast<std::uint32_t>(static_cast<std::uint64_t>(card_us));
  out.bfee_count = count_++;
  out.nrx = kAntennas;
  out.ntx = 1;
  for (std::size_t a = 0; a < kAntennas; ++a) out.rssi[a] = rssi_for(levels.power_dbm[a], agc_db);
  out.noise_dbm = kNoiseUnknown_dbm;
  out.agc_db = agc_db;
  out.perm = trouble.perm;
  out.perm_valid = true;
  out.antenna_sel = antenna_sel_of(trouble.perm);
  out.payload_length = 60 * kAntennas + 12;
  out.rate = band_.is_40mhz ? kRateHt40 : kRateHt20;
}

void Radio::write_matrix(const PacketTrouble& trouble, const ReceiverChannel& h, CounterRng& rng,
                         CsiRecord& out) const {
  const ReceiverChannel x = distort(nic_, trouble, band_, h);
  const double scale = csi_scale(nic_, trouble, x);
  // Thermal and converter noise are independent and Gaussian: one draw with the sum of their powers, half of
  // it in each of the two components.
  const double thermal =
      on_.thermal_noise ? scale * scale * power(kThermalNoise_dbm - nic_.transmit_power_dbm) : 0;
  const double sigma = std::sqrt((thermal + (on_.converter_noise ? 1 : 0)) / 2);
  bool any = false;
  for (std::size_t k = 0; k < kSubcarriers; ++k)
    for (std::size_t a = 0; a < kAntennas; ++a) {
      const std::complex<double> value = scale * x[k][a] + (sigma > 0 ? sigma * rng.complex_normal() : 0);
      const std::size_t i = CsiRecord::index(k, a, 0);
      out.csi[i] = quantise(value.real());
      out.csi[i + 1] = quantise(value.imag());
      any = any || out.csi[i] != 0 || out.csi[i + 1] != 0;
    }
  out.all_zero_csi = !any;
  out.all_zero_rssi = out.rssi == std::array<std::uint8_t, kAntennas>{};
}

}  // namespace csipose::sim
