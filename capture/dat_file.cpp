#include "capture/dat_file.h"

#include <unistd.h>

#include <algorithm>

#include "proto/result.h"

namespace csipose {
namespace {

constexpr std::size_t kStandingRecords = 8;
constexpr std::int64_t kMaxStep_us = 60'000'000;  // longer: the clock was set, not the transmitter silent
constexpr std::int64_t kMaxUsual_us = 1'000'000;  // steps that count as the usual distance of two records

bool stamps_are_wide(ByteView bytes) {
  if (bytes.size() < 16) return false;
  for (std::size_t at = 0; at + 16 <= bytes.size(); at += 16)
    if (load_le<std::uint32_t>(bytes.data() + at + 4) != 0 ||
        load_le<std::uint64_t>(bytes.data() + at + 8) >= 1'000'000)
      return false;
  return true;
}

std::string side_file_of(const std::string& path) { return path + "stp"; }

bool exists(const std::string& path) { return ::access(path.c_str(), F_OK) == 0; }

}  // namespace

std::vector<std::int64_t> parse_side_file(ByteView bytes, std::size_t records) {
  const bool wide = stamps_are_wide(bytes);
  const std::size_t entry = wide ? 16 : 8;
  std::vector<std::int64_t> stamps;
  for (std::size_t at = 0; at + entry <= bytes.size() && stamps.size() < records; at += entry) {
    const std::uint32_t s = load_le<std::uint32_t>(bytes.data() + at);
    const std::uint32_t us = load_le<std::uint32_t>(bytes.data() + at + entry / 2);
    if (us >= 1'000'000) return {};
    stamps.push_back(s * std::int64_t{1'000'000'000} + us * std::int64_t{1000});
  }
  return stamps;
}

NicLine unwrap_nic_clock(const std::vector<std::uint32_t>& us) {
  NicLine line;
  std::vector<std::int64_t> deltas_us, usual;
  std::size_t same = 1, longest = 1;
  for (std::size_t i = 1; i < us.size(); ++i) {
    deltas_us.push_back(static_cast<std::int32_t>(us[i] - us[i - 1]));
    if (deltas_us.back() > 0 && deltas_us.back() < kMaxUsual_us) usual.push_back(deltas_us.back());
    same = deltas_us.back() == 0 ? same + 1 : 1;
    longest = std::max(longest, same);
  }
  line.stands_still = longest >= std::min(kStandingRecords, std::max<std::size_t>(us.size(), 2));
  if (!usual.empty()) {
    std::nth_element(usual.begin(), usual.begin() + static_cast<std::ptrdiff_t>(usual.size() / 2),
                     usual.end());
    line.usual_step_ns = 1000 * usual[usual.size() / 2];
  }
  line.time_ns.assign(us.empty() ? 0 : 1, 0);
  for (const std::int64_t delta : deltas_us) {
    const bool was_set = delta < 0 || delta > kMaxStep_us;
    line.steps += was_set;
    line.time_ns.push_back(line.time_ns.back() + (was_set ? line.usual_step_ns : 1000 * delta));
  }
  return line;
}

DatFile::DatFile(const std::string& path, const DatOptions& options) : path_(path), file_(path) {
  read_packets();
  if (counts_.codes[kCsiCode] == 0)
    throw SetupError(ExitStatus::bad_data, path + " is not a csitool log: it holds no CSI record");
  const std::string side = side_file_of(path);
  if (options.use_side_file && options.rate_hz == 0 && exists(side)) {
    const MappedFile stamps(side);
    time_by_side_file(parse_side_file(stamps.bytes(), stamped_records_));
  } else {
    time_by_clock(options.rate_hz);
  }
}

void DatFile::read_packets() {
  RecordStream stream(file_.bytes(), RecordStream::Policy::resynchronising);
  DatPacket packet;
  while (const auto record = stream.next()) {
    ++counts_.codes[record->code];
    if (record->code != kFrameCode && record->code != kCsiCode) continue;
    const std::size_t stamp = stamped_records_++;
    if (record->code == kFrameCode && packet.frame.code != 0) {  // the frame before got no CSI
      packets_.push_back(std::exchange(packet, {}));
      stamp_of_packet_.push_back(stamp - 1);
    }
    (record->code == kFrameCode ? packet.frame : packet.csi) = *record;
    if (record->code == kCsiCode) {
      packets_.push_back(std::exchange(packet, {}));
      stamp_of_packet_.push_back(stamp);
    }
  }
  counts_.faults = stream.counts().faults;
}

void DatFile::time_by_side_file(const std::vector<std::int64_t>& stamps) {
  if (stamps.empty())
    throw SetupError(ExitStatus::bad_data,
                     side_file_of(path_) +
                         " is not a side file of csiread's log_to_file (u32 seconds, u32 "
                         "microseconds per record); remove it to replay by the NIC's clock");
  std::size_t count = 0;  // both files are cut where the logger was killed: what has no stamp has no time
  while (count < packets_.size() && stamp_of_packet_[count] < stamps.size()) ++count;
  packets_.resize(count);
  std::int64_t newest = 0;
  for (std::size_t i = 0; i < count; ++i) {
    const std::int64_t stamp = stamps[stamp_of_packet_[i]];
    clock_steps_ += stamp < newest;
    newest = std::max(newest, stamp);  // UTC of a host may be set back; arrival never runs back
    packets_[i].arrival_ns = newest;
  }
  has_utc_ = true;
  if (count > 0)
    period_ = Nanoseconds((newest - packets_[0].arrival_ns) * static_cast<std::int64_t>(count) /
                          std::max<std::int64_t>(1, static_cast<std::int64_t>(count) - 1));
}

void DatFile::time_by_clock(double rate_hz) {
  std::vector<std::uint32_t> timestamps;
  std::vector<std::size_t> timed;  // packets that have a clock
  for (std::size_t i = 0; i < packets_.size(); ++i) {
    if (packets_[i].csi.body.size() < 4) continue;
    timestamps.push_back(load_le<std::uint32_t>(packets_[i].csi.body.data()));
    timed.push_back(i);
  }
  NicLine line = unwrap_nic_clock(timestamps);
  if (rate_hz > 0) {
    line.usual_step_ns = static_cast<std::int64_t>(1e9 / rate_hz);
    for (std::size_t i = 0; i < timed.size(); ++i)
      line.time_ns[i] = static_cast<std::int64_t>(1e9 * static_cast<double>(i) / rate_hz);
  } else if (line.stands_still) {
    throw SetupError(ExitStatus::bad_data,
                     path_ + " has no usable clock: the NIC's timestamp stands still, and there is no " +
                         side_file_of(path_) + "; give the rate at which it was recorded (rate_hz, --rate)");
  }
  clock_steps_ = rate_hz > 0 ? 0 : line.steps;
  std::size_t next = 0;  // a packet without a clock shares the time of the next that has one, or of the last
  for (std::size_t i = 0; i < packets_.size() && !timed.empty(); ++i) {
    while (next + 1 < timed.size() && timed[next] < i) ++next;
    packets_[i].arrival_ns = line.time_ns[next];
  }
  period_ = Nanoseconds((line.time_ns.empty() ? 0 : line.time_ns.back()) + line.usual_step_ns);
}

ByteView DatFile::records(const DatPacket& packet, std::vector<std::uint8_t>& scratch) {
  if (packet.frame.code == 0) return packet.csi.framed();
  if (packet.csi.code == 0) return packet.frame.framed();
  const ByteView frame = packet.frame.framed(), csi = packet.csi.framed();
  if (frame.end() == csi.begin()) return {frame.data(), frame.size() + csi.size()};
  scratch.assign(frame.begin(), frame.end());
  scratch.insert(scratch.end(), csi.begin(), csi.end());
  return scratch;
}

}  // namespace csipose
