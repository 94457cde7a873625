// daemon/metrics.h - the status as Prometheus text, for a textfile collector.
//
// Base units, prefix csiposed_; no label carries a person, a token or an address. docs/stream.md lists the
// names.
#pragma once

#include <string>

#include "proto/status.h"

namespace csipose {

/// What the kernel says of this process, for the usual process_* metrics.
struct ProcessUse {
  double cpu_seconds = 0, start_time_seconds = 0;
  std::uint64_t resident_bytes = 0, virtual_bytes = 0, open_fds = 0;
};
ProcessUse process_use();

std::string prometheus_text(const Status& status, const ProcessUse& process);

/// Replaces the file in one step: whoever reads it sees the old text or the new. Throws SetupError.
void write_metrics_file(const std::string& path, const std::string& text);

}  // namespace csipose
