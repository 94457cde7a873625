#include "daemon/inspect_words.h"

#include <fmt/format.h>

#include <algorithm>

#include "proto/intel5300.h"

namespace csipose {
namespace {

constexpr std::size_t kMostOfOneKind = 5;  // places named before "and N more"
constexpr double kWeakShare =
    0.05;  // of entries that are 0: tuned on csiread's sample, whose antenna B has 3 %

std::string plural(std::uint64_t count, const char* word) {
  return fmt::format("{} {}{}", count, word, count == 1 ? "" : "s");
}

const char* meaning(RecordFault fault) {
  switch (fault) {
    case RecordFault::leftover:
      return "fewer than 3 bytes are left, too few for a record";
    case RecordFault::zero_length:
      return "a record of length 0";
    case RecordFault::truncated:
      return "the record passes the end: the logger was stopped, or its length is damaged";
    case RecordFault::lost_framing:
      return "an unknown record code that leads nowhere";
    case RecordFault::short_record:
      return "CSI records shorter than their header";
    case RecordFault::bad_dims:
      return "CSI records that claim other than 1 to 3 chains or streams";
    case RecordFault::bad_len:
      return "CSI records whose payload length does not fit their size";
    case RecordFault::payload_short:
      return "CSI records that end inside their payload";
    case RecordFault::perm_invalid:
      return "CSI records that do not tell which chain is which antenna; unusable";
    case RecordFault::all_zero_csi:
      return "CSI records that are all zero; unusable";
    case RecordFault::all_zero_rssi:
      return "CSI records without any RSSI; they cannot be scaled";
    case RecordFault::resync:
      break;
  }
  return "places where reading was taken up again";
}

using Sentences = std::vector<std::string>;

void add_framing(const LogCounts& log, Sentences& out) {
  for (std::size_t i = 0; i < std::min(log.faults.size(), kMostOfOneKind); ++i)
    out.push_back(fmt::format("byte {}: {} ({})", log.faults[i].offset, meaning(log.faults[i].fault),
                              name(log.faults[i].fault)));
  if (log.faults.size() > kMostOfOneKind)
    out.push_back(fmt::format("and {} more framing faults like these", log.faults.size() - kMostOfOneKind));
  if (const auto found = log.records[RecordFault::resync])
    out.push_back(
        fmt::format("reading was taken up again {}", found == 1 ? "once" : fmt::format("{} times", found)));
  if (log.is_cut) out.emplace_back("the recording was cut: its end is missing; all whole chunks were read");
  if (log.bad_chunks > 0)
    out.push_back(
        fmt::format("{} of the recording are damaged and were left out", plural(log.bad_chunks, "chunk")));
}

void add_content(const RecordCounts& counts, Sentences& out) {
  for (auto fault = RecordFault::short_record; fault <= RecordFault::all_zero_rssi;
       fault = static_cast<RecordFault>(static_cast<int>(fault) + 1))
    if (fault != RecordFault::resync && counts[fault] > 0)
      out.push_back(fmt::format("{} {} ({})", counts[fault], meaning(fault), name(fault)));
}

void add_sizes(const ReceiverReport& receiver, Sentences& out) {
  std::uint64_t few_chains = 0;
  for (const auto& [size, count] : receiver.sizes) few_chains += size.front() == '3' ? 0 : count;
  if (few_chains > 0)
    out.push_back(fmt::format("{} of fewer than 3 chains: unusable for poses, check the antennas",
                              plural(few_chains, "record")));
  if (receiver.wide > 0 && receiver.wide < receiver.records)
    out.push_back(
        fmt::format("20 and 40 MHz are mixed ({} of {} records are 40 MHz); a window takes one width",
                    receiver.wide, receiver.records));
}

void add_clock(const ClockReport& clock, Sentences& out) {
  if (clock.stands_still)
    out.emplace_back("the NIC's clock stands still: order and gaps cannot be told from it");
  for (std::size_t i = 0; i < std::min(clock.steps_back.size(), kMostOfOneKind); ++i)
    out.push_back(fmt::format("the NIC's clock was set back by {:.6f} s before CSI record {}",
                              clock.steps_back[i].length_s, clock.steps_back[i].record));
  if (clock.steps_back.size() > kMostOfOneKind)
    out.push_back(
        fmt::format("and {} more steps back of the clock", clock.steps_back.size() - kMostOfOneKind));
  if (clock.gaps.empty()) return;
  const auto longest = *std::max_element(clock.gaps.begin(), clock.gaps.end(),
                                         [](auto& a, auto& b) { return a.length_s < b.length_s; });
  out.push_back(fmt::format("{} in time, the longest {:.1f} ms before CSI record {}",
                            plural(clock.gaps.size(), "gap"), 1e3 * longest.length_s, longest.record));
}

void add_driver(const DriverCountReport& driver, Sentences& out) {
  if (driver.lost > 0)
    out.push_back(fmt::format("{} lost between driver and file, in {} (bfee_count): reader or disk too slow",
                              plural(driver.lost, "record"), plural(driver.gaps, "place")));
  if (driver.repeated > 0)
    out.push_back(fmt::format(
        "{} with the bfee_count of the one before: duplicated, or fields not filled in by the driver",
        plural(driver.repeated, "record")));
  if (driver.steps_back > 0)
    out.push_back(fmt::format("bfee_count ran back {}: the driver was loaded anew",
                              driver.steps_back == 1 ? "once" : fmt::format("{} times", driver.steps_back)));
}

void add_frames(const FrameReport& frames, Sentences& out) {
  if (frames.bad_fcs > 0)
    out.push_back(
        fmt::format("{} with a wrong check sum (FCS): damaged on the air", plural(frames.bad_fcs, "frame")));
  if (frames.too_short > 0)
    out.push_back(fmt::format("{} too short for a data frame", plural(frames.too_short, "frame")));
  if (frames.without_csi > 0)
    out.push_back(fmt::format("{} without CSI", plural(frames.without_csi, "frame")));
  if (frames.records > 0 && frames.counted == 0)
    out.emplace_back("no transmit counter in the frames: receivers can be aligned by time only");
  if (frames.missing > 0)
    out.push_back(fmt::format("{} never came (transmit counter)", plural(frames.missing, "sent frame")));
  if (frames.repeated > 0)
    out.push_back(
        fmt::format("{} with the transmit counter of the one before", plural(frames.repeated, "frame")));
  if (frames.backward > 0)
    out.push_back(
        fmt::format("the transmit counter ran back {}: transmitter restarted, or frames out of order",
                    frames.backward == 1 ? "once" : fmt::format("{} times", frames.backward)));
}

void add_signal(const ReceiverReport& receiver, Sentences& out) {
  for (std::size_t antenna = 0; antenna < kAntennas; ++antenna) {
    const std::uint64_t entries = receiver.entries[antenna], zeros = receiver.zero_entries[antenna];
    if (entries > 0 && static_cast<double>(zeros) > kWeakShare * static_cast<double>(entries))
      out.push_back(
          fmt::format("antenna {}: {:.0f} % of its entries are 0, too weak to be measured; check its cable",
                      static_cast<char>('A' + antenna),
                      100.0 * static_cast<double>(zeros) / static_cast<double>(entries)));
  }
  if (receiver.saturated > 0)
    out.push_back(
        fmt::format("{} with a component at the end of its 8 bits", plural(receiver.saturated, "record")));
}

std::string range_text(const Range& range, const char* unit) {
  if (range.count == 0) return "unknown";
  return fmt::format("{:.1f} {} ({:.1f} to {:.1f})", range.mean(), unit, range.least, range.greatest);
}

template <class Map>
std::string histogram_text(const Map& histogram) {
  std::string text;
  for (const auto& [word, count] : histogram)
    text += fmt::format("{}{} ({})", text.empty() ? "" : ", ", word, count);
  return text.empty() ? "none" : text;
}

std::string rate_text(const ClockReport& clock) {
  if (clock.stands_still || clock.median_step_s <= 0) return "unknown: the NIC's clock does not tell";
  return fmt::format("{:.1f} per second (median step {:.3f} ms) over {:.3f} s", 1 / clock.median_step_s,
                     1e3 * clock.median_step_s, clock.duration_s);
}

std::string counter_text(const FrameReport& frames) {
  if (frames.records == 0) return "no frames (0xC1) in the file";
  if (frames.counted == 0) return fmt::format("{}, no counter in them", plural(frames.records, "frame"));
  return fmt::format("{} to {} by {}, {} missing, in {}", frames.first, frames.last, name(frames.method),
                     frames.missing, plural(frames.records, "frame"));
}

std::string receiver_text(const ReceiverReport& r) {
  std::string text;
  const auto line = [&text](const char* label, const std::string& value) {
    text += fmt::format("  {:<14}{}\n", label, value);
  };
  line("CSI records", fmt::format("{}, of which {} usable for poses", r.records, r.usable));
  if (r.records > 0) {
    line("rate", rate_text(r.clock));
    line("sizes", histogram_text(r.sizes));
    line("antenna order", histogram_text(r.permutations));
    line("modulation", histogram_text(r.rates));
    for (std::size_t antenna = 0; antenna < kAntennas; ++antenna)
      line(antenna == 0 ? "RSSI" : "",
           fmt::format("{}: {}", static_cast<char>('A' + antenna), range_text(r.rssi_db[antenna], "dB")));
    line("received", range_text(r.rss_dbm, "dBm"));
    line("AGC", range_text(r.agc_db, "dB"));
    line("noise", range_text(r.noise_dbm, "dBm"));
    line("bfee_count", fmt::format("{} lost, {} repeated, {} run back, {}", r.driver.lost, r.driver.repeated,
                                   r.driver.steps_back, plural(r.driver.wraps, "wrap")));
  }
  line("tx counter", counter_text(r.frames));
  for (const std::string& sentence : r.anomalies) line("!", sentence);
  return text;
}

}  // namespace

std::vector<std::string> anomalies(const ReceiverReport& receiver) {
  Sentences out;
  add_framing(receiver.log, out);
  add_content(receiver.log.records, out);
  add_sizes(receiver, out);
  add_clock(receiver.clock, out);
  add_driver(receiver.driver, out);
  add_frames(receiver.frames, out);
  add_signal(receiver, out);
  return out;
}

std::string to_text(const Inspection& inspection) {
  std::string text =
      fmt::format("{}: {}, {} bytes\n", inspection.file,
                  inspection.is_recording ? "csipose recording" : "csitool log", inspection.bytes);
  if (inspection.records() == 0 && !inspection.is_recording)
    text = fmt::format("{}: not a csitool log, or one without CSI: {} bytes, no CSI record in them\n",
                       inspection.file, inspection.bytes);
  for (const ReceiverReport& receiver : inspection.receivers) {
    if (inspection.is_recording) text += fmt::format("receiver {}\n", receiver.name);
    text += receiver_text(receiver);
  }
  return text;
}

}  // namespace csipose
