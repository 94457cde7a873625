#include "daemon/metrics.h"

#include <fmt/format.h>
#include <unistd.h>

#include <cerrno>
#include <cmath>
#include <cstring>
#include <filesystem>
#include <fstream>
#include <iterator>
#include <sstream>

#include "proto/result.h"
#include "proto/wire.h"

namespace csipose {
namespace {

/// Text exposition format 0.0.4: a metric's HELP and TYPE once, then its samples.
class Page {
 public:
  void metric(const char* name, const char* type, const char* help) {
    name_ = name;
    fmt::format_to(std::back_inserter(text_), "# HELP {0} {1}\n# TYPE {0} {2}\n", name, help, type);
  }
  void sample(const std::string& labels, double value) { line("", labels, value); }
  void line(const char* suffix, const std::string& labels, double value) {
    const std::string braces = labels.empty() ? "" : '{' + labels + '}';
    const std::string number = std::isnan(value) ? "NaN" : fmt::format("{}", value);
    fmt::format_to(std::back_inserter(text_), "{}{}{} {}\n", name_, suffix, braces, number);
  }
  void one(const char* name, const char* type, const char* help, double value) {
    metric(name, type, help);
    sample("", value);
  }
  std::string take() { return std::move(text_); }

 private:
  std::string text_, name_;
};

std::string label(const std::string& name, std::string_view value) {
  std::string escaped;
  for (const char c : value) {
    if (c == '\\' || c == '"') escaped += '\\';
    escaped += c == '\n' ? ' ' : c;
  }
  return name + "=\"" + escaped + '"';
}

void histogram(Page& page, const std::string& labels, const LatencyHistogram& h) {
  const std::string comma = labels.empty() ? "" : ",";
  for (std::size_t i = 0; i < LatencyHistogram::kEdgesUs.size(); ++i) {
    const std::uint32_t edge_us = LatencyHistogram::kEdgesUs[i];
    page.line("_bucket", labels + comma + label("le", fmt::format("{}", edge_us / 1e6)),
              static_cast<double>(h.at_most(i)));
  }
  page.line("_bucket", labels + comma + label("le", "+Inf"), static_cast<double>(h.count()));
  page.line("_sum", labels, static_cast<double>(h.sum_us()) / 1e6);
  page.line("_count", labels, static_cast<double>(h.count()));
}

void counts(Page& page, const std::string& name, const std::vector<NamedCount>& values) {
  for (const NamedCount& value : values)
    page.sample(label(name, value.name), static_cast<double>(value.count));
}

void describe_program(const Status& status, Page& page) {
  page.metric("csiposed_build_info", "gauge", "Version and commit.");
  page.sample(label("version", status.version) + ',' + label("commit", status.commit), 1);
  page.metric("csiposed_source_info", "gauge", "Where packets come from: live, replay or simulated.");
  page.sample(label("kind", name_of(status.source)), 1);
  page.metric("csiposed_model_info", "gauge",
              "Digest of the weights; untrained weights give poses that mean nothing.");
  page.sample(label("sha256", status.model) + ',' + label("untrained", status.untrained ? "true" : "false"),
              1);
  page.metric("csiposed_state", "gauge", "1 for the state that holds.");
  for (int s = static_cast<int>(State::warmup); s <= static_cast<int>(State::fault); ++s)
    page.sample(label("state", name_of(static_cast<State>(s))),
                status.state == static_cast<State>(s) ? 1 : 0);
}

void describe_frames(const Status& status, Page& page) {
  page.one("csiposed_frames_published_total", "counter", "Frames given to subscribers.",
           static_cast<double>(status.frames_published));
  page.metric("csiposed_windows_total", "counter", "Windows by what they lacked, and those not inferred.");
  counts(page, "result", status.windows);
  page.one("csiposed_deadline_misses_total", "counter", "Results that were late and dropped.",
           static_cast<double>(status.deadline_misses));
  page.one("csiposed_people", "gauge", "People in the newest frame.", status.people);
  page.metric("csiposed_stage_duration_seconds", "histogram", "Time spent per stage and window.");
  for (const StageStatus& stage : status.stages)
    if (stage.name != "end_to_end") histogram(page, label("stage", stage.name), stage.histogram);
  page.metric("csiposed_end_to_end_seconds", "histogram",
              "From a window's last sample to the frame's publication.");
  for (const StageStatus& stage : status.stages)
    if (stage.name == "end_to_end") histogram(page, "", stage.histogram);
}

/// One metric over all receivers.
template <class Value>
void per_receiver(const Status& status, Page& page, const char* name, const char* type, const char* help,
                  Value value) {
  page.metric(name, type, help);
  for (const ReceiverStatus& rx : status.receivers)
    page.sample(label("rx", rx.id), static_cast<double>(value(rx)));
}

void describe_receivers(const Status& status, Page& page) {
  using Rx = ReceiverStatus;
  per_receiver(status, page, "csiposed_rx_packets_total", "counter", "Packets taken in.",
               [](const Rx& rx) { return rx.packets; });
  per_receiver(status, page, "csiposed_rx_lost_total", "counter",
               "Frames lost on the air or before they came here.", [](const Rx& rx) { return rx.lost; });
  per_receiver(status, page, "csiposed_rx_rate_hertz", "gauge", "Usable records a second.",
               [](const Rx& rx) { return rx.rate_hz; });
  per_receiver(status, page, "csiposed_rx_last_packet_timestamp_seconds", "gauge",
               "UTC of the newest packet.",
               [](const Rx& rx) { return static_cast<double>(ns(rx.last_packet)) / 1e9; });
  per_receiver(status, page, "csiposed_rx_clock_error_seconds", "gauge",
               "Bound that the agent's host gives; 0 = unknown.",
               [](const Rx& rx) { return static_cast<double>(rx.clock_error_ns) / 1e9; });
  page.metric("csiposed_rx_rejected_total", "counter", "Datagrams and records refused.");
  for (const Rx& rx : status.receivers)
    for (const NamedCount& reason : rx.rejected)
      page.sample(label("rx", rx.id) + ',' + label("reason", reason.name), static_cast<double>(reason.count));
  page.metric("csiposed_rx_rssi_dbm", "gauge", "Mean over the newest window; NaN = nothing received.");
  for (const Rx& rx : status.receivers)
    for (std::size_t a = 0; a < kAntennas; ++a)
      page.sample(label("rx", rx.id) + ',' + label("antenna", std::string(1, static_cast<char>('A' + a))),
                  static_cast<double>(rx.rssi_dbm[a]));
}

void describe_clients(const Status& status, Page& page) {
  page.metric("csiposed_clients", "gauge", "Connected clients.");
  page.sample(label("transport", "unix"), static_cast<double>(status.clients.size()));
  page.metric("csiposed_client_dropped_frames_total", "counter", "Frames lost because clients were slow.");
  page.sample(label("transport", "unix"), static_cast<double>(status.client_dropped_frames));
  page.one("csiposed_ring_dropped_frames_total", "counter", "Frames lost between loop and publisher.",
           static_cast<double>(status.ring_dropped_frames));
  page.metric("csiposed_auth_failures_total", "counter",
              "Datagrams and connections that proved no identity.");
  counts(page, "transport", status.auth_failures);
  page.metric("csiposed_config_reloads_total", "counter", "Reloads by outcome.");
  counts(page, "result", status.config_reloads);
  page.one("csiposed_recording_bytes_total", "counter", "Written to recordings.",
           static_cast<double>(status.recording.bytes));
  page.one("csiposed_recording_errors_total", "counter", "Writes that went wrong.",
           static_cast<double>(status.recording.errors));
  page.one("csiposed_watchdog_pings_total", "counter", "Signs of life to systemd.",
           static_cast<double>(status.watchdog_pings));
}

void describe_process(const ProcessUse& use, Page& page) {
  page.one("process_cpu_seconds_total", "counter", "User and system time.", use.cpu_seconds);
  page.one("process_start_time_seconds", "gauge", "UTC of the start.", use.start_time_seconds);
  page.one("process_resident_memory_bytes", "gauge", "Resident memory.",
           static_cast<double>(use.resident_bytes));
  page.one("process_virtual_memory_bytes", "gauge", "Virtual memory.",
           static_cast<double>(use.virtual_bytes));
  page.one("process_open_fds", "gauge", "Open file descriptors.", static_cast<double>(use.open_fds));
}

std::string slurp(const char* path) {
  std::ifstream file(path);
  return {std::istreambuf_iterator<char>(file), {}};
}

double boot_time_seconds() {
  const std::string stat = slurp("/proc/stat");
  const auto at = stat.find("btime ");
  return at == std::string::npos ? 0 : std::stod(stat.substr(at + 6));
}

}  // namespace

ProcessUse process_use() {
  ProcessUse use;
  // proc(5): after "pid (comm) " come state and numbers; utime is field 14, stime 15, starttime 22, vsize 23,
  // rss 24.
  const std::string stat = slurp("/proc/self/stat");
  std::istringstream fields(stat.substr(std::min(stat.size(), stat.rfind(')') + 1)));
  std::string field;
  const auto ticks = static_cast<double>(sysconf(_SC_CLK_TCK));
  for (int i = 3; fields >> field; ++i) {
    if (i == 14 || i == 15) use.cpu_seconds += std::stod(field) / ticks;
    if (i == 22) use.start_time_seconds = boot_time_seconds() + std::stod(field) / ticks;
    if (i == 23) use.virtual_bytes = std::stoull(field);
    if (i == 24) use.resident_bytes = std::stoull(field) * static_cast<std::uint64_t>(sysconf(_SC_PAGESIZE));
  }
  std::error_code error;
  for (std::filesystem::directory_iterator fd("/proc/self/fd", error), end; !error && fd != end;
       fd.increment(error))
    ++use.open_fds;
  return use;
}

std::string prometheus_text(const Status& status, const ProcessUse& process) {
  Page page;
  describe_program(status, page);
  describe_frames(status, page);
  describe_receivers(status, page);
  describe_clients(status, page);
  describe_process(process, page);
  return page.take();
}

void write_metrics_file(const std::string& path, const std::string& text) {
  const std::string fresh = path + ".new";
  const auto give_up = [&](const char* what) {
    const std::string why = std::strerror(errno);
    unlink(fresh.c_str());
    throw SetupError(
        ExitStatus::cannot_create,
        fmt::format("The metrics file {} cannot be {}: {}. Check metrics.textfile and its folder.", path,
                    what, why));
  };
  std::ofstream file(fresh, std::ios::trunc);
  file << text;
  file.close();
  if (!file) give_up("written");
  if (rename(fresh.c_str(), path.c_str()) != 0) give_up("put in place");
}

}  // namespace csipose
