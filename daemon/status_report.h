// daemon/status_report.h - the counters of loop, front end and source as one Status, and as the lines that
// people read.
#pragma once

#include <string>
#include <vector>

#include "capture/source.h"
#include "daemon/log.h"
#include "daemon/loop_status.h"
#include "proto/status.h"

namespace csipose {

/// Puts what the loop and the source count into `status`, whose fixed facts (name, model, engine ...) stay.
void fill_status(Status& status, const LoopStatus& loop, const SourceStats& source,
                 const std::vector<std::string>& receiver_ids);

/// "LIVE 3/3 rx 299.8 Hz, 2 people, p99 31 ms"
std::string status_line(const Status& status);

/// Lines for the log: what has changed from one status of the loop to the next.
class ChangeReporter {
 public:
  ChangeReporter(Log& log, std::vector<std::string> receiver_ids)
      : log_(log), receiver_ids_(std::move(receiver_ids)) {}
  void report(const LoopStatus& now);

 private:
  void report_state(const LoopStatus& now);
  void report_receivers(const LoopStatus& now);
  void report_misses(const LoopStatus& now);

  Log& log_;
  const std::vector<std::string> receiver_ids_;
  LoopStatus before_{};
  bool windows_seen_ = false;
};

}  // namespace csipose
