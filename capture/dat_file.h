// capture/dat_file.h - csitool's log file as packets with times of arrival.
//
// The log itself says nothing of time. csiread's log_to_file writes a side file X.datstp beside X.dat: per
// 0xBB and 0xC1 record u32 seconds and u32 microseconds (two u64 on some 64-bit senders), little-endian, UTC
// of the receiver's host. Without it, arrival is rebuilt from the NIC's microsecond clock inside the CSI
// records:
//   - it wraps every 2^32 us, and is unwrapped;
//   - a step back, or one of more than a minute forward, is the clock being set (it follows an access point):
//   the step is
//     counted and replaced by the usual distance between two records;
//   - a clock that stands still over 8 records tells nothing: a rate has to be given, and then replaces the
//   clock.
// C++17-clean.
#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include "proto/bytes.h"
#include "proto/mapped_file.h"
#include "proto/record_stream.h"
#include "proto/time.h"

namespace csipose {

/// Reads a .datstp side file: UTC of each of `records` records in ns. Empty when the bytes are no such file;
/// shorter than `records` when the side file was cut.
std::vector<std::int64_t> parse_side_file(ByteView bytes, std::size_t records);

/// What one 0xC1 with its 0xBB, or either alone, is in the file.
struct DatPacket {
  RawRecord frame, csi;         ///< code 0: not there
  std::int64_t arrival_ns = 0;  ///< since the file's first packet; UTC when the file has a side file
};

struct DatOptions {
  double rate_hz = 0;  ///< not 0: packets are this far apart, whatever the NIC's clock says
  bool use_side_file = true;
};

class DatFile {
 public:
  /// Reads the whole file. Throws SetupError when it cannot be read, holds no CSI record ("not a csitool
  /// log"), or has no usable clock and no rate is given. Damage inside is passed over and counted.
  explicit DatFile(const std::string& path, const DatOptions& options = {});

  const std::string& path() const { return path_; }
  const std::vector<DatPacket>& packets() const { return packets_; }
  bool has_utc() const { return has_utc_; }
  std::uint64_t clock_steps() const { return clock_steps_; }
  const RecordCounts& counts() const { return counts_; }
  /// Time from the first packet to where the first packet of a repetition belongs.
  Nanoseconds period() const { return period_; }

  /// The records of a packet in a row; `scratch` is used when something lies between them in the file.
  static ByteView records(const DatPacket& packet, std::vector<std::uint8_t>& scratch);

 private:
  void read_packets();
  void time_by_side_file(const std::vector<std::int64_t>& stamps);
  void time_by_clock(double rate_hz);

  std::string path_;
  MappedFile file_;
  std::vector<DatPacket> packets_;
  std::vector<std::size_t> stamp_of_packet_;  // place in the side file
  std::size_t stamped_records_ = 0;
  bool has_utc_ = false;
  std::uint64_t clock_steps_ = 0;
  RecordCounts counts_;
  Nanoseconds period_{};
};

/// The NIC's clock of successive records as a line that never runs back, ns from its first record.
struct NicLine {
  std::vector<std::int64_t> time_ns;
  std::int64_t usual_step_ns = 0;
  std::uint64_t steps = 0;    ///< times the clock was set
  bool stands_still = false;  ///< the same for 8 records in a row (or for all, of fewer): unusable
};
NicLine unwrap_nic_clock(const std::vector<std::uint32_t>& timestamps_us);

}  // namespace csipose
