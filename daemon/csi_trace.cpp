#include "daemon/csi_trace.h"

#include <filesystem>

#include "daemon/log_file.h"
#include "proto/intel5300.h"

namespace csipose {
namespace {

template <class Visit>
void for_each_usable(const LogFile& log, std::size_t receiver, Visit visit) {
  log.for_each(receiver, RecordStream::Policy::resynchronising, [&](const LogRecord& entry) {
    CsiRecord record;
    if (entry.raw.code == kCsiCode && !decode_bfee(entry.raw.body, record) && record.usable()) visit(record);
  });
}

}  // namespace

std::vector<CsiTrace> trace_csi(const std::string& path, std::size_t columns) {
  const std::unique_ptr<LogFile> log = open_log(path);
  std::vector<CsiTrace> traces;
  for (const std::string& name : log->receivers()) {
    const std::size_t receiver = traces.size();
    CsiTrace& trace = traces.emplace_back();
    trace.name = std::filesystem::path(name).filename().string();
    for_each_usable(*log, receiver, [&](const CsiRecord&) { ++trace.records; });
    std::uint64_t n = 0;
    for_each_usable(*log, receiver, [&](const CsiRecord& record) {
      // Record n is drawn when it is the first of its column.
      const bool is_first = trace.records <= columns || n * columns / trace.records == trace.columns.size();
      ++n;
      Features features;
      if (is_first && extract_features(record, {}, features)) trace.columns.push_back(features);
    });
  }
  return traces;
}

}  // namespace csipose
