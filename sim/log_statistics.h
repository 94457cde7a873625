// sim/log_statistics.h - what a receiver's log looks like from afar: the figures that tell a simulated card from a real one.
//
// The same for recorded and for simulated logs, so that they can be laid side by side (docs/simulator-statistics.md).
#pragma once

#include <string>
#include <vector>

#include "proto/bytes.h"

namespace csipose::sim {

/// Mean and standard deviation, and the 5th and 95th hundredth part.
struct Spread {
  double mean = 0, deviation = 0, low = 0, high = 0;
};
Spread spread_of(std::vector<double> values);

struct LogStatistics {
  std::size_t records = 0;  ///< usable ones: three chains, known order, CSI not zero
  Spread amplitude;         ///< |X|, counts
  Spread csi_power_db;      ///< of a record: sum over antennas, mean over subcarriers
  Spread delay_ns;          ///< slope of the phase over frequency, all antennas together: 20 MHz records
  double median_delay_step_ns = 0;  ///< from record to record
  double carrier_concentration =
      0;  ///< |mean of e^{j phase}| at the middle subcarrier: 0 anybody's guess, 1 fixed
  double antenna_concentration = 0;  ///< of the phase between antennas A and B there
  Spread agc_db, rssi_db, received_dbm;
  double agc_rssi_correlation = 0;  ///< of gain and received power; not a number where either stands still
  Spread step_ms;                   ///< from record to record, by the card's clock
  double missing_share = 0;         ///< of the grid that the median step spans
};

/// Of all usable records of a csitool log. Throws SetupError (bad_data) when it has fewer than two.
LogStatistics log_statistics(ByteView log, const std::string& name_for_words);

}  // namespace csipose::sim
