// daemon/inspect.h - what a person who debugs a receiver wants to know of its records, gathered in one pass.
//
// Here is looked at, judged nowhere: nothing is refused but by the closed list of proto/record_stream.h, and whatever
// is odd becomes a sentence in `anomalies`. inspect_report.h tells it to people and programs.
#pragma once

#include <cstdint>
#include <limits>
#include <map>
#include <string>
#include <vector>

#include "capture/tx_counter.h"
#include "daemon/log_file.h"
#include "proto/csi_record.h"

namespace csipose {

/// Least, mean and greatest of what was added.
struct Range {
  double least = std::numeric_limits<double>::infinity();
  double greatest = -std::numeric_limits<double>::infinity();
  double sum = 0;
  std::uint64_t count = 0;

  void add(double value);
  double mean() const { return sum / static_cast<double>(count); }
};

/// A stretch of time in which nothing came.
struct ClockGap {
  std::uint64_t record = 0;  ///< the CSI record after it, counted from 0
  double length_s = 0;
};

/// The NIC's microsecond clock over the records.
struct ClockReport {
  std::uint64_t wraps = 0;           ///< of 32 bits: ordinary
  std::vector<ClockGap> steps_back;  ///< the clock was set back by length_s
  std::vector<ClockGap> gaps;        ///< longer than 2.5 usual distances
  bool stands_still = false;         ///< the same in 8 records in a row: unusable
  double median_step_s = 0;          ///< 0 = fewer than two records
  double duration_s = 0;             ///< sum of all steps forward
};

/// The driver's counter of CSI notifications.
struct DriverCountReport {
  std::uint64_t lost = 0;        ///< records that the driver made and the file has not
  std::uint64_t gaps = 0;        ///< places where some are lost
  std::uint64_t repeated = 0;    ///< the same number again
  std::uint64_t steps_back = 0;  ///< driver loaded anew
  std::uint64_t wraps = 0;
};

/// 0xC1 records and the transmit counters in them.
struct FrameReport {
  std::uint64_t records = 0, too_short = 0, bad_fcs = 0;
  std::uint64_t without_csi = 0;                    ///< another frame came before any CSI did
  CounterMethod method = CounterMethod::automatic;  ///< automatic = no counter was found
  std::uint64_t counted = 0;                        ///< frames whose counter could be told
  std::uint64_t first = 0, last = 0;                ///< counters as they were sent
  std::uint64_t missing = 0;                        ///< counters between first and last that never came
  std::uint64_t repeated = 0, backward = 0;
};

struct ReceiverReport {
  std::string name;
  LogCounts log;
  std::uint64_t records = 0, usable = 0;       ///< CSI records that decode; of these fit for a window
  std::map<std::string, std::uint64_t> sizes;  ///< "3x1": chains x streams
  std::map<std::string, std::uint64_t>
      permutations;                            ///< "BCA": antenna of chain 0, 1, 2; "?" where there is none
  std::map<std::string, std::uint64_t> rates;  ///< "MCS 1, 20 MHz"
  std::array<Range, kAntennas> rssi_db;        ///< above the card's reference, where the antenna is in use
  Range rss_dbm, agc_db, noise_dbm;
  std::uint64_t noise_unknown = 0;
  std::array<std::uint64_t, kAntennas> entries{}, zero_entries{};  ///< CSI entries; of these 0+0j
  std::uint64_t saturated = 0;  ///< records with a component at -128 or 127
  std::uint64_t wide = 0;       ///< 40 MHz records
  ClockReport clock;
  DriverCountReport driver;
  FrameReport frames;
  std::vector<std::string> anomalies;  ///< sentences for people, in order of weight
};

struct Inspection {
  std::string file;
  bool is_recording = false;
  std::uint64_t bytes = 0;
  std::vector<ReceiverReport> receivers;

  std::uint64_t records() const;
  std::uint64_t usable() const;
  RecordCounts counts() const;  ///< of all receivers
};

/// Reads the whole file. Throws SetupError when it cannot be read.
Inspection inspect(const std::string& path, RecordStream::Policy policy);

}  // namespace csipose
