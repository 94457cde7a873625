#include "sim/log_statistics.h"

#include <gtest/gtest.h>

#include <cmath>
#include <numbers>

#include "proto/intel5300.h"
#include "proto/result.h"
#include "sim/band.h"
#include "sim/human_scene.h"
#include "sim/receiver_log.h"
#include "sim/solved_scene.h"

namespace csipose::sim {
namespace {

TEST(Spread, OfOneToHundred) {
  std::vector<double> values;
  for (int i = 1; i <= 100; ++i) values.push_back(i);
  const Spread spread = spread_of(values);
  EXPECT_DOUBLE_EQ(spread.mean, 50.5);
  EXPECT_NEAR(spread.deviation, std::sqrt(833.25), 1e-9);
  EXPECT_EQ(spread.low, 5);
  EXPECT_EQ(spread.high, 95);
}

/// A log of matrices whose phase falls with frequency as a delay makes it, turned anew for each record.
std::vector<std::uint8_t> log_with(double delay_s, int records) {
  std::vector<std::uint8_t> log;
  for (int i = 0; i < records; ++i) {
    CsiRecord record;
    record.nrx = 3, record.ntx = 1, record.antenna_sel = 0x24, record.rssi = {40, 40, 40};
    record.agc_db = static_cast<std::uint8_t>(30 + i % 3), record.rate = 0x101;
    record.timestamp_low = static_cast<std::uint32_t>(i * 2000);
    for (std::size_t k = 0; k < kSubcarriers; ++k)
      for (std::size_t a = 0; a < kAntennas; ++a) {
        const double phase =
            -2 * std::numbers::pi * subcarrier_indices(false)[k] * kToneSpacing_hz * delay_s + 2.4 * i +
            0.5 * static_cast<double>(a);
        const auto x = std::polar(100.0, phase);
        record.csi[CsiRecord::index(k, a, 0)] = static_cast<std::int8_t>(std::lround(x.real()));
        record.csi[CsiRecord::index(k, a, 0) + 1] = static_cast<std::int8_t>(std::lround(x.imag()));
      }
    append_bfee_record(record, log);
  }
  return log;
}

ByteView view(const std::vector<std::uint8_t>& bytes) {
  return {reinterpret_cast<const char*>(bytes.data()), bytes.size()};
}

TEST(LogStatistics, GivesBackWhatALogWasMadeWith) {
  const auto log = log_with(205e-9, 300);
  const LogStatistics s = log_statistics(view(log), "made");
  EXPECT_EQ(s.records, 300u);
  EXPECT_NEAR(s.delay_ns.mean, 205, 0.5);
  EXPECT_LT(s.delay_ns.deviation, 1);
  EXPECT_NEAR(s.csi_power_db.mean, 10 * std::log10(3 * 1e4), 0.05);
  EXPECT_LT(s.carrier_concentration, 0.05);
  EXPECT_GT(s.antenna_concentration, 0.999);
  EXPECT_NEAR(s.agc_rssi_correlation, -1, 1e-9) << "equal RSSI: the gain alone tells the power";
  EXPECT_NEAR(s.step_ms.mean, 2, 1e-9);
  EXPECT_NEAR(s.missing_share, 0, 1e-9);
}

TEST(LogStatistics, RefusesWhatHasNoRecords) { EXPECT_THROW(log_statistics({}, "empty.dat"), SetupError); }

// Simulated cards lie within what was seen of real ones: docs/simulator-statistics.md.
TEST(LogStatistics, SimulatedCardsLookLikeRealOnes) {
  for (std::uint32_t clip = 0; clip < 3; ++clip) {
    const auto channels = solve_as_it_moves(std::make_unique<HumanScene>(
        HumanSpec{read_room_plan("office"), 1, {Action::walk}, false}, 1, clip, 300));
    ReceiverBank bank(impairments(ImpairmentLevel::intel5300), Band{}, 1, clip, 300);
    std::array<std::vector<std::uint8_t>, kReceivers> logs;
    for (int i = 0; i < 300; ++i) bank.send(channels->next().channel, logs);
    for (const auto& log : logs) {
      const LogStatistics s = log_statistics(view(log), "simulated");
      EXPECT_TRUE(s.delay_ns.mean > 170 && s.delay_ns.mean < 290) << s.delay_ns.mean;
      EXPECT_TRUE(s.median_delay_step_ns > 3 && s.median_delay_step_ns < 40) << s.median_delay_step_ns;
      EXPECT_TRUE(s.csi_power_db.mean > 29.5 && s.csi_power_db.mean < 38) << s.csi_power_db.mean;
      EXPECT_LT(s.csi_power_db.deviation, 0.8);
      EXPECT_LT(s.carrier_concentration, 0.15) << "about 1 / sqrt(records)";
      EXPECT_TRUE(s.agc_db.mean > 10 && s.agc_db.mean <= 63) << s.agc_db.mean;
      EXPECT_LT(s.missing_share, 0.15);
    }
  }
}

}  // namespace
}  // namespace csipose::sim
