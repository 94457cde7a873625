#include "sim/radio.h"

#include <gtest/gtest.h>

#include <cmath>
#include <set>
#include <vector>

#include "proto/intel5300.h"
#include "sim/geometry.h"
#include "sim/reflector.h"
#include "tests/sim/golden.h"

namespace csipose::sim {
namespace {
constexpr double kRate_hz = 300;

/// Equal waves on all antennas and subcarriers, of total power `total` (received over transmitted).
ReceiverChannel flat_channel(double total) {
  ReceiverChannel h;
  for (auto& tone : h) tone.fill(std::sqrt(total / kAntennas));
  return h;
}

ReceiverChannel golden_channel(const nlohmann::json& j) {
  ReceiverChannel h;
  for (std::size_t k = 0; k < kSubcarriers; ++k)
    for (std::size_t a = 0; a < kAntennas; ++a)
      h[k][a] = {j["re"][k][a].get<double>(), j["im"][k][a].get<double>()};
  return h;
}

Nic golden_nic(const nlohmann::json& c) {
  Nic nic;
  nic.transmit_power_dbm = c["ptx_dbm"].get<double>();
  nic.gain = c["gain"].get<std::array<double, 3>>();
  nic.phase_rad = c["psi"].get<std::array<double, 3>>();
  nic.csi_power_db = c["csi_power_db"].get<double>();
  nic.clock_zero_us = c["timestamp_low"].get<double>();
  nic.first_count = c["bfee_count"].get<std::uint16_t>();
  return nic;
}

std::string hex(const std::vector<std::uint8_t>& bytes) {
  std::string text;
  for (const std::uint8_t byte : bytes)
    text += "0123456789abcdef"[byte >> 4], text += "0123456789abcdef"[byte & 15];
  return text;
}

TEST(Radio, MeetsTheGoldenBytes) {
  CSIPOSE_NEEDS_SHARED_DATA();
  for (const auto& c : testing::golden_list("bfee.json", "cases")) {
    PacketTrouble trouble;
    trouble.carrier_phase_rad = c["phi"].get<double>();
    trouble.delay_s = c["tau"].get<double>();
    trouble.perm = c["perm"].get<std::array<std::uint8_t, 3>>();
    Radio radio(impairments(ImpairmentLevel::none), Band{}, golden_nic(c), 0, kRate_hz);
    CounterRng unused = PacketId{}.rng(0);
    CsiRecord record;
    radio.record(trouble, 0, golden_channel(c["H_true"]), unused, record);
    EXPECT_EQ(record.agc_db, c["agc"].get<int>());
    EXPECT_EQ(record.antenna_sel, c["antenna_sel"].get<int>());
    std::vector<std::uint8_t> bytes;
    append_bfee_record(record, bytes);
    EXPECT_EQ(hex(bytes), c["record_hex"].get<std::string>());
  }
}

// csitool's relation, run backwards: what the record says must be what came in, to the rounding of its
// fields.
TEST(Radio, SignalStrengthAndGainTellTheReceivedPower) {
  const Nic nic;
  for (double loss_db = 50; loss_db < 75; loss_db += 0.7) {
    Radio radio(impairments(ImpairmentLevel::none), Band{}, nic, 0, kRate_hz);
    CsiRecord record;
    ASSERT_TRUE(radio.receive({}, 0, flat_channel(std::pow(10, -loss_db / 10)), record));
    double milliwatt = 0;
    for (const std::uint8_t rssi : record.rssi) milliwatt += std::pow(10, rssi / 10.0);
    const double told_dbm = 10 * std::log10(milliwatt) - 44 - record.agc_db;
    EXPECT_NEAR(told_dbm, nic.transmit_power_dbm - loss_db, 0.5 + 1e-9);
    EXPECT_NEAR(record.agc_db, -3 - (nic.transmit_power_dbm - loss_db), 0.5 + 1e-9);
  }
}

TEST(Radio, GainStopsAtItsLimits) {
  EXPECT_EQ(agc_for(-200), 63);
  EXPECT_EQ(agc_for(+20), 0);
  EXPECT_EQ(rssi_for(-200, 63), 0);
}

TEST(Radio, GainStaysWithinOneDecibelBeforeItMoves) {
  Radio radio(impairments(ImpairmentLevel::none), Band{}, Nic{}, 0, kRate_hz);
  const auto agc_at = [&](double loss_db) {
    CsiRecord record;
    EXPECT_TRUE(radio.receive({}, 0, flat_channel(std::pow(10, -loss_db / 10)), record));
    return record.agc_db;
  };
  EXPECT_EQ(agc_at(58.0), 40);
  EXPECT_EQ(agc_at(58.9), 40);
  EXPECT_EQ(agc_at(57.1), 40);
  EXPECT_EQ(agc_at(59.2), 41);
}

TEST(Radio, MatrixHasTheCardsUsualPower) {
  Nic nic;
  nic.csi_power_db = 33;
  Radio radio(impairments(ImpairmentLevel::none), Band{}, nic, 0, kRate_hz);
  CsiRecord record;
  ASSERT_TRUE(radio.receive({}, 0, flat_channel(1e-6), record));
  double sum = 0;
  for (const std::int8_t value : record.csi) sum += value * value;
  EXPECT_NEAR(10 * std::log10(sum / kSubcarriers), 33, 0.2);  // rounding of 26 to whole numbers
}

TEST(Distort, DelayIsASlopeOfPhaseAndPhaseDifferencesBetweenAntennasStay) {
  PacketTrouble trouble;
  trouble.delay_s = 200e-9;
  trouble.carrier_phase_rad = 1.0;
  const Band band;
  const auto x = distort(Nic{}, trouble, band, flat_channel(1));
  for (std::size_t k = 0; k < kSubcarriers; ++k) {
    const double expected = 1.0 - 2 * kPi * subcarrier_indices(false)[k] * 312.5e3 * 200e-9;
    EXPECT_NEAR(std::remainder(std::arg(x[k][0]) - expected, 2 * kPi), 0, 1e-12);
    EXPECT_NEAR(std::arg(x[k][2] / x[k][0]), 0, 1e-12);
  }
}

TEST(Distort, FortyMegahertzTurnsTheUpperHalfByAQuarter) {
  Band band;
  band.is_40mhz = true;
  const auto x = distort(Nic{}, {}, band, flat_channel(1));
  EXPECT_NEAR(std::arg(x[14][0]), 0, 1e-12);        // subcarrier -2
  EXPECT_NEAR(std::arg(x[15][0]), kPi / 2, 1e-12);  // subcarrier +2
}

TEST(Radio, SamePacketsGiveTheSameRecords) {
  const auto run = [] {
    const Impairments on = impairments(ImpairmentLevel::intel5300);
    Radio radio(on, Band{}, draw_nic(on, 3, 1, 2), 2, kRate_hz);
    std::vector<std::uint8_t> bytes;
    for (std::uint32_t p = 0; p < 200; ++p) {
      CsiRecord record;
      if (radio.receive({3, 1, p}, p / kRate_hz, flat_channel(1e-6), record))
        append_bfee_record(record, bytes);
    }
    return bytes;
  };
  EXPECT_EQ(run(), run());
}

// One installation, recorded again and again: seed and clip change what happens, never the cards.
TEST(Radio, CardsThatStayPoweredAreTheSameInEveryClip) {
  Impairments on = impairments(ImpairmentLevel::intel5300);
  on.power_up = 2;
  const Nic first = draw_nic(on, 1, 0, 1), later = draw_nic(on, 77, 12, 1);
  EXPECT_EQ(first.phase_rad, later.phase_rad);
  EXPECT_EQ(first.gain, later.gain);
  EXPECT_EQ(first.passband, later.passband);
  EXPECT_EQ(first.transmit_power_dbm, later.transmit_power_dbm);
  EXPECT_NE(first.phase_rad, draw_nic(on, 1, 0, 2).phase_rad);  // another receiver
  on.power_up = 3;
  EXPECT_NE(first.phase_rad, draw_nic(on, 1, 0, 1).phase_rad);
  on.power_up = 0;
  EXPECT_NE(draw_nic(on, 1, 0, 1).phase_rad, draw_nic(on, 1, 12, 1).phase_rad);
}

struct Heard {
  std::vector<CsiRecord> records;
  std::vector<std::uint32_t> numbers;
};
Heard hear(const Impairments& on, std::uint32_t packets) {
  const Nic nic = draw_nic(on, 11, 0, 0);
  Radio radio(on, Band{}, nic, 0, kRate_hz);
  Heard heard;
  for (std::uint32_t p = 0; p < packets; ++p) {
    CsiRecord record;
    if (!radio.receive({11, 0, p}, p / kRate_hz, flat_channel(1e-6), record)) continue;
    heard.records.push_back(record);
    heard.numbers.push_back(p);
  }
  return heard;
}

TEST(Radio, LosesTheStatedShareInBursts) {
  constexpr std::uint32_t kPackets = 60'000;
  Impairments only_losses;
  only_losses.losses = true;
  const Heard heard = hear(only_losses, kPackets);
  const double lost = 1 - static_cast<double>(heard.records.size()) / kPackets;
  EXPECT_NEAR(lost, 0.98 * 0.005 + 0.02 * 0.30, 0.002);
  // Bursts: after a lost packet the next one is lost far more often than on average.
  std::size_t pairs = 0;
  for (std::size_t i = 1; i < heard.numbers.size(); ++i) pairs += heard.numbers[i] - heard.numbers[i - 1] > 2;
  EXPECT_GT(static_cast<double>(pairs), 5 * lost * lost * kPackets);
}

TEST(Radio, DriverCountsWhatItReportsAndTheCardsClockRuns) {
  const Heard heard = hear(impairments(ImpairmentLevel::intel5300), 3000);
  const Nic nic = draw_nic(impairments(ImpairmentLevel::intel5300), 11, 0, 0);
  ASSERT_LT(heard.records.size(), 3000u);
  for (std::size_t i = 0; i < heard.records.size(); ++i) {
    EXPECT_EQ(heard.records[i].bfee_count, static_cast<std::uint16_t>(nic.first_count + i));
    const double elapsed_us = heard.numbers[i] / kRate_hz * 1e6 * nic.clock_rate;
    const std::uint32_t start_us = static_cast<std::uint32_t>(nic.clock_zero_us);
    EXPECT_NEAR(heard.records[i].timestamp_low - start_us, elapsed_us, 1.5);
  }
}

TEST(Radio, AllSixOrdersOfAntennasComeAndTheMatrixFollowsThem) {
  Impairments only_order;
  only_order.antenna_order = true;
  std::set<int> seen;
  for (const CsiRecord& record : hear(only_order, 200).records) {
    seen.insert(record.antenna_sel);
    std::vector<std::uint8_t> bytes;
    append_bfee_record(record, bytes);
    CsiRecord read;
    ASSERT_FALSE(decode_bfee(ByteView(bytes).sub(kRecordHeaderBytes), read));
    EXPECT_EQ(read.csi, record.csi);
  }
  EXPECT_EQ(seen, (std::set<int>{36, 24, 9, 18, 33, 6}));
}

TEST(Radio, CarrierPhaseIsAnybodysGuess) {
  Impairments only_phase;
  only_phase.carrier_phase = true;
  std::complex<double> sum = 0;
  const Heard heard = hear(only_phase, 4000);
  for (const CsiRecord& record : heard.records) {
    const std::complex<double> h = record.at(3, 1, 0);
    sum += h / std::abs(h);
  }
  EXPECT_LT(std::abs(sum) / static_cast<double>(heard.records.size()), 0.05);  // uniform: about 1/sqrt(4000)
}

TEST(AccessDelay, IsSharedNeverNegativeAndOnAverageAsStated) {
  Impairments on;
  on.channel_access = true;
  double sum = 0;
  constexpr std::uint32_t kPackets = 20'000;
  for (std::uint32_t p = 0; p < kPackets; ++p) {
    const double delay = access_delay_s(on, {1, 0, p});
    ASSERT_GE(delay, 0);
    sum += delay;
  }
  EXPECT_NEAR(sum / kPackets, 60e-6 + 0.05 * 1.15e-3, 5e-6);
}

}  // namespace
}  // namespace csipose::sim
