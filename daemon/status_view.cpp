#include "daemon/status_view.h"

#include <fmt/format.h>

#include <cmath>

#include "daemon/live_view.h"

namespace csipose {
namespace {

Line title(const char* text) { return {{text, Tone::dim}}; }

std::string duration(double time_s) {
  const auto whole = static_cast<std::uint64_t>(time_s);
  if (whole < 60) return fmt::format("{:.1f} s", time_s);
  return fmt::format("{:d} h {:02d} min {:02d} s", whole / 3600, whole / 60 % 60, whole % 60);
}

std::string counts(const std::vector<NamedCount>& values) {
  std::string text;
  for (const NamedCount& value : values)
    if (value.count > 0) text += fmt::format("{}{} {}", text.empty() ? "" : ", ", value.count, value.name);
  return text.empty() ? "none" : text;
}

/// Which badges hold, as in the live view.
Line head(const Status& status) {
  PoseFrame frame;
  frame.source = status.source;
  frame.state = status.state;
  frame.reasons = status.reasons;
  frame.untrained = status.untrained;
  return state_bar({}, &frame);
}

void add_identity(const Status& status, std::vector<Line>& lines) {
  lines.push_back({{fmt::format("{}   csiposed {} ({})   up {}", status.name, status.version, status.commit,
                                duration(status.uptime_s))}});
  lines.push_back({{"Source   ", Tone::dim}, {status.source_text}});
  lines.push_back(
      {{"Model    ", Tone::dim},
       {fmt::format("{}   {}   {}", status.model.substr(0, 12), status.model_text, status.model_path)}});
  lines.push_back({{"Engine   ", Tone::dim}, {status.engine}});
  lines.push_back({{"Settings ", Tone::dim}, {status.config_path}});
}

void add_receiver(const ReceiverStatus& rx, std::vector<Line>& lines) {
  const auto sent = static_cast<double>(rx.usable + rx.lost);
  std::string rssi;
  for (const float dbm : rx.rssi_dbm) rssi += std::isnan(dbm) ? "     -" : fmt::format("{:6.0f}", dbm);
  lines.push_back(
      {{fmt::format("  {:<10}", rx.id), rx.present ? Tone::strong : Tone::alarm},
       {fmt::format("{:8.1f} {}  {:>10} {:>9} {:>6.2f} %  {:>8} {:>9.3f}", rx.rate_hz, rssi, rx.packets,
                    rx.lost, sent > 0 ? 100 * static_cast<double>(rx.lost) / sent : 0.0,
                    std::isnan(rx.skew_ppm) ? "-" : fmt::format("{:.2f}", rx.skew_ppm), rx.match_ratio)}});
  if (const std::string refused = counts(rx.rejected); refused != "none")
    lines.push_back({{"             refused: " + refused, Tone::warning}});
}

void add_latencies(const ReceivedStatus& status, std::vector<Line>& lines) {
  lines.push_back(title("Time per window       median       p99     p99.9       max   (ms)"));
  for (const auto& l : status.latency)
    lines.push_back({{fmt::format("  {:<16}{:>10.2f}{:>10.2f}{:>10.2f}{:>10.2f}", l.stage, l.p50_ms, l.p99_ms,
                                  l.p999_ms, l.max_ms)}});
  lines.push_back({{fmt::format("  budget {:.0f} ms, {} results were late and dropped",
                                status.status.budget_ms, status.status.deadline_misses),
                    status.status.deadline_misses > 0 ? Tone::warning : Tone::plain}});
}

void add_clients(const Status& status, std::vector<Line>& lines) {
  lines.push_back(title("Clients"));
  for (const ClientStatus& client : status.clients)
    lines.push_back({{fmt::format("  {:<44} {:<9} {:>9} sent {:>7} lost", client.name, name_of(client.level),
                                  client.sent, client.dropped),
                      client.dropped > 0 ? Tone::warning : Tone::plain}});
  const RecordingStatus& recording = status.recording;
  lines.push_back({{"Recording ", Tone::dim},
                   {recording.active ? fmt::format("{}, {:.1f} MB", recording.file,
                                                   static_cast<double>(recording.bytes) / 1e6)
                                     : "off"}});
  if (recording.errors > 0)
    lines.push_back({{fmt::format("  {} writes went wrong", recording.errors), Tone::alarm}});
}

}  // namespace

std::vector<Line> render_status(const ReceivedStatus& received) {
  const Status& status = received.status;
  std::vector<Line> lines = {head(status)};
  add_identity(status, lines);
  lines.push_back({});
  lines.push_back(
      title("Receivers        Hz   RSSI A    B     C     packets      lost             skew ppm  matched"));
  for (const ReceiverStatus& rx : status.receivers) add_receiver(rx, lines);
  lines.push_back({{fmt::format("  transmitter {:.1f} Hz", status.transmit_hz), Tone::dim}});
  lines.push_back({});
  lines.push_back({{"Windows  ", Tone::dim}, {counts(status.windows)}});
  lines.push_back(
      {{"Frames   ", Tone::dim},
       {fmt::format(
           "{} published, {} people in the last; lost: {} between loop and publisher, {} by slow clients",
           status.frames_published, status.people, status.ring_dropped_frames,
           status.client_dropped_frames)}});
  add_latencies(received, lines);
  add_clients(status, lines);
  return lines;
}

}  // namespace csipose
