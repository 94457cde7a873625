// daemon/log_file.h - a csitool .dat log or one of our .mcap recordings, record by record, for the tools that look
// into files: inspect, convert.
#pragma once

#include <functional>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "proto/record_stream.h"
#include "proto/time.h"

namespace csipose {

/// One record of one receiver.
struct LogRecord {
  RawRecord raw;  ///< its offset is a place in a .dat file; in a recording, within its packet
  std::optional<SteadyTime> arrival;  ///< where the file says so
};

/// What reading a receiver's records ended with.
struct LogCounts {
  RecordCounts records;              ///< framing faults and codes
  std::vector<FramingFault> faults;  ///< of a .dat file, each in turn
  bool is_cut = false;               ///< of a recording: it has no end
  std::uint64_t bad_chunks = 0;      ///< of a recording: chunks that were damaged
  std::uint64_t poses = 0;           ///< of a recording: frames of people in it
};

class LogFile {
 public:
  using Visitor = std::function<void(const LogRecord&)>;
  virtual ~LogFile() = default;
  /// One name per receiver; a .dat file has one receiver.
  virtual std::vector<std::string> receivers() const = 0;
  /// Calls `visit` with each record of that receiver in file order. May be called again.
  virtual LogCounts for_each(std::size_t receiver, RecordStream::Policy policy,
                             const Visitor& visit) const = 0;
  virtual std::uint64_t bytes() const = 0;
  virtual bool is_recording() const = 0;
};

/// Opens by content, not by name. Throws SetupError when the file cannot be read. A file that is neither is taken for a
/// .dat log, in which nothing will be found.
std::unique_ptr<LogFile> open_log(const std::string& path);

}  // namespace csipose
