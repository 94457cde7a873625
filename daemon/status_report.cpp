#include "daemon/status_report.h"

#include <fmt/chrono.h>
#include <fmt/format.h>

#include <algorithm>

#include "proto/record_stream.h"
#include "proto/wire.h"

namespace csipose {
namespace {

constexpr std::array<const char*, kStages> kStageNames = {"ingest", "align", "window", "infer", "publish"};

bool receiver_present(const LinkSet& links, std::size_t receiver) {
  return (links >> (receiver * kAntennas) & LinkSet(7)).any();
}

void fill_receiver(ReceiverStatus& out, std::size_t receiver, const LoopStatus& loop,
                   const SourceStats& source) {
  const ReceiverStats& front = loop.front_end.receivers[receiver];
  out.present = receiver_present(loop.links, receiver);
  out.rate_hz = front.rate_hz;
  out.rssi_dbm = loop.receivers[receiver].rssi_dbm;
  out.last_packet = loop.last_packet[receiver];
  out.packets = source.receivers[receiver].packets;
  out.usable = front.usable;
  out.lost = front.lost_air + front.lost_driver;
  out.filled = front.filled;
  out.offset_s = front.offset_s;
  out.skew_ppm = front.skew_ppm;
  out.residual_s = front.residual_s;
  out.match_ratio = front.match_ratio;
  out.clock_epochs = front.clock_epochs;
  const double clock_error_s = source.receivers[receiver].clock_error_s;
  out.clock_error_ns = clock_error_s > 0 ? static_cast<std::uint64_t>(clock_error_s * 1e9) : 0;
}

void add_if_any(std::vector<NamedCount>& counts, const std::string& name, std::uint64_t count) {
  if (count > 0) counts.push_back({name, count});
}

void fill_rejected(ReceiverStatus& out, std::size_t receiver, const LoopStatus& loop,
                   const SourceStats& source) {
  const ReceiverStats& front = loop.front_end.receivers[receiver];
  for (std::size_t fault = 0; fault < front.faults.size(); ++fault)
    if (front.faults[fault] > 0)
      out.rejected.push_back({name(static_cast<RecordFault>(fault)), front.faults[fault]});
  add_if_any(out.rejected, "bad_fcs", front.bad_fcs);
  add_if_any(out.rejected, "no_counter", front.no_counter);
  add_if_any(out.rejected, "duplicate", front.duplicates);
  add_if_any(out.rejected, "late", front.late);
  add_if_any(out.rejected, "lost_on_the_way", source.receivers[receiver].lost);
  add_if_any(out.rejected, "left_out_by_agent", source.receivers[receiver].omitted);
  for (const SourceStats::Refusal& refusal : source.refusals)
    if (refusal.receiver == static_cast<int>(receiver))
      out.rejected.push_back({refusal.reason, refusal.count});
}

}  // namespace

void fill_status(Status& status, const LoopStatus& loop, const SourceStats& source,
                 const std::vector<std::string>& receiver_ids) {
  status.state = loop.state;
  status.reasons = loop.reasons;
  status.people = loop.people;
  status.transmit_hz = loop.front_end.tx_hz;
  status.frames_published = loop.frames;
  status.deadline_misses = loop.deadline;
  status.windows = {{"ok", loop.ok},          {"gap", loop.gap},           {"skew", loop.skew},
                    {"nan", loop.not_finite}, {"deadline", loop.deadline}, {"skipped", loop.skipped}};
  status.stages.clear();
  for (std::size_t stage = 0; stage < kStages; ++stage)
    status.stages.push_back({kStageNames[stage], loop.stages[stage]});
  status.stages.push_back({"end_to_end", loop.end_to_end});
  status.receivers.assign(receiver_ids.size(), {});
  for (std::size_t receiver = 0; receiver < receiver_ids.size(); ++receiver) {
    status.receivers[receiver].id = receiver_ids[receiver];
    fill_receiver(status.receivers[receiver], receiver, loop, source);
    fill_rejected(status.receivers[receiver], receiver, loop, source);
  }
  status.auth_failures.clear();
  for (const SourceStats::Refusal& refusal : source.refusals)
    if (refusal.receiver < 0) status.auth_failures.push_back({refusal.reason, refusal.count});
}

std::string status_line(const Status& status) {
  std::string source(name_of(status.source)), state(name_of(status.state));
  std::ranges::transform(source, source.begin(),
                         [](unsigned char c) { return static_cast<char>(std::toupper(c)); });
  std::ranges::transform(state, state.begin(),
                         [](unsigned char c) { return static_cast<char>(std::toupper(c)); });
  double rate_hz = 0;
  std::size_t present = 0;
  for (const ReceiverStatus& receiver : status.receivers) {
    present += receiver.present;
    rate_hz = std::max(rate_hz, receiver.rate_hz);
  }
  const double p99_ms = status.stages.empty() ? 0 : status.stages.back().histogram.quantile_us(0.99) / 1e3;
  return fmt::format("{}{} {}, {}/{} rx {:.1f} Hz, {} people, {} frames, {} deadlines missed, p99 {:.1f} ms",
                     source, status.untrained ? " UNTRAINED" : "", state, present, status.receivers.size(),
                     rate_hz, status.people, status.frames_published, status.deadline_misses, p99_ms);
}

void ChangeReporter::report(const LoopStatus& now) {
  report_state(now);
  report_receivers(now);
  report_misses(now);
  before_ = now;
}

void ChangeReporter::report_state(const LoopStatus& now) {
  const bool quiet =
      now.state == before_.state ||
      (now.state <= State::tracking && now.state != State::warmup && before_.state <= State::tracking &&
       before_.state != State::warmup);  // people come and go: no news for a log
  if (!quiet) log_.info(fmt::format("state is {} reasons={}", name_of(now.state), names_of(now.reasons)));
  if (now.skipped > before_.skipped)
    log_.debug(fmt::format("windows passed over because their instant was gone count={}",
                           now.skipped - before_.skipped));
}

void ChangeReporter::report_receivers(const LoopStatus& now) {
  if (now.ok + now.gap + now.skew + now.not_finite == 0) return;  // no window yet
  for (std::size_t receiver = 0; receiver < receiver_ids_.size(); ++receiver) {
    const bool was = receiver_present(before_.links, receiver), is = receiver_present(now.links, receiver);
    if (is && !was)
      log_.info(fmt::format("receiver {} is here packets={}", receiver_ids_[receiver],
                            now.front_end.receivers[receiver].packets));
    if (!is && (was || !windows_seen_))
      log_.warn(fmt::format("receiver {} is missing; its links are left out until it comes back packets={}",
                            receiver_ids_[receiver], now.front_end.receivers[receiver].packets));
  }
  windows_seen_ = true;
}

void ChangeReporter::report_misses(const LoopStatus& now) {
  const std::uint64_t unseen = now.deadline - before_.deadline;
  const std::uint64_t kept = std::min<std::uint64_t>(unseen, LoopStatus::kKeptMisses);
  for (std::uint64_t miss = now.deadline - kept; miss < now.deadline; ++miss) {
    const DeadlineMiss& one = now.misses[miss % LoopStatus::kKeptMisses];
    log_.warn(fmt::format("result dropped, it was not ready in time window_end_ns={} late_us={} infer_us={}",
                          ns(one.last_sample), one.late_us, one.infer_us));
  }
  if (unseen > kept) log_.warn(fmt::format("further results dropped, not listed count={}", unseen - kept));
}

}  // namespace csipose
