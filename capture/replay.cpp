#include "capture/replay.h"

#include <algorithm>
#include <cstdlib>
#include <optional>
#include <string_view>
#include <unordered_map>

#include "capture/dat_file.h"
#include "proto/mapped_file.h"
#include "proto/recording.h"
#include "proto/result.h"

namespace csipose {
namespace {

std::string_view bytes_of(const RawRecord& record) {
  return {reinterpret_cast<const char*>(record.body.data()), record.body.size()};
}

// Where a frame lies in the first file. A frame may come again (the stock injector repeats after 20,000).
class FrameIndex {
 public:
  explicit FrameIndex(const std::vector<DatPacket>& packets) {
    for (std::size_t i = 0; i < packets.size(); ++i)
      if (packets[i].frame.code != 0) places_[bytes_of(packets[i].frame)].push_back(i);
  }
  /// The first place of this frame that is not before `from`; -1 when there is none.
  std::ptrdiff_t find(const RawRecord& frame, std::size_t from) const {
    if (frame.code == 0) return -1;
    const auto found = places_.find(bytes_of(frame));
    if (found == places_.end()) return -1;
    const auto place = std::lower_bound(found->second.begin(), found->second.end(), from);
    return place == found->second.end() ? -1 : static_cast<std::ptrdiff_t>(*place);
  }

 private:
  std::unordered_map<std::string_view, std::vector<std::size_t>> places_;
};

// The same frame cannot be this much further on by one clock than by the other: it is a repetition.
constexpr std::int64_t kMaxDisagreement_ns = 2'000'000'000;

// Times of `packets` on the first file's clock; as they are when no frame is common.
std::vector<std::int64_t> tie_to_first(const FrameIndex& index, const std::vector<DatPacket>& first,
                                       const std::vector<DatPacket>& packets) {
  std::optional<std::int64_t> offset_ns;
  std::size_t next_place = 0;
  std::vector<std::int64_t> times;
  for (const DatPacket& packet : packets) {
    const std::ptrdiff_t match = index.find(packet.frame, next_place);
    if (match >= 0) {
      const std::int64_t offset = first[static_cast<std::size_t>(match)].arrival_ns - packet.arrival_ns;
      if (!offset_ns)  // what came before the first common frame is as far before it as its own clock says
        for (std::int64_t& time : times) time += offset;
      if (!offset_ns || std::abs(offset - *offset_ns) < kMaxDisagreement_ns) {
        offset_ns = offset;
        next_place = static_cast<std::size_t>(match) + 1;
      }
    }
    const std::int64_t time = packet.arrival_ns + offset_ns.value_or(0);
    times.push_back(times.empty() ? time : std::max(time, times.back()));
  }
  return times;
}

class DatReplay final : public PacketSource {
 public:
  explicit DatReplay(const ReplayConfig& config) : loop_(config.loop) {
    for (const std::string& path : config.files) files_.emplace_back(path, DatOptions{config.rate_hz});
    require_same_clock();
    merge();
  }

  SourceEvent poll(Nanoseconds, Packet& packet) override {
    if (next_ == order_.size()) {
      if (!loop_) return SourceEvent::closed;
      next_ = 0;
      shift_ns_ += period_ns_;
    }
    const Entry& entry = order_[next_++];
    const std::int64_t time_ns = entry.time_ns + shift_ns_;
    packet = {entry.receiver, SteadyTime(Nanoseconds(time_ns)), UtcTime(Nanoseconds(time_ns + utc_ns_)),
              DatFile::records(files_[entry.receiver].packets()[entry.packet], scratch_)};
    ++packets_[entry.receiver];
    return SourceEvent::packet;
  }
  Source kind() const override { return Source::replay; }
  std::string describe() const override {
    std::string text = "replay";
    for (const DatFile& file : files_) text += " " + file.path();
    return text;
  }
  SourceStats stats() const override {
    SourceStats stats;
    for (std::size_t i = 0; i < files_.size(); ++i) {
      stats.receivers[i].packets = packets_[i];
      for (std::size_t f = 0; f <= static_cast<std::size_t>(RecordFault::lost_framing); ++f)
        if (files_[i].counts().faults[f] > 0)
          stats.refusals.push_back(
              {static_cast<int>(i), name(static_cast<RecordFault>(f)), files_[i].counts().faults[f]});
    }
    return stats;
  }

 private:
  struct Entry {
    std::int64_t time_ns;
    std::uint8_t receiver;
    std::uint32_t packet;
  };

  void require_same_clock() const {
    for (const DatFile& file : files_)
      if (file.has_utc() != files_[0].has_utc())
        throw SetupError(ExitStatus::bad_data,
                         "of " + files_[0].path() + " and " + file.path() +
                             " only one has a .datstp side file, so they share no clock; give side "
                             "files to all or to none");
  }

  void merge() {
    const FrameIndex index(files_[0].packets());
    for (std::size_t r = 0; r < files_.size(); ++r) {
      const auto& packets = files_[r].packets();
      const bool tied = r > 0 && !files_[r].has_utc();
      const std::vector<std::int64_t> times =
          tied ? tie_to_first(index, files_[0].packets(), packets) : std::vector<std::int64_t>{};
      for (std::uint32_t i = 0; i < packets.size(); ++i)
        order_.push_back({tied ? times[i] : packets[i].arrival_ns, static_cast<std::uint8_t>(r), i});
      period_ns_ = std::max(period_ns_, ns(files_[r].period()));
    }
    std::stable_sort(order_.begin(), order_.end(),
                     [](const Entry& a, const Entry& b) { return a.time_ns < b.time_ns; });
    if (order_.empty()) return;
    const std::int64_t origin = order_.front().time_ns;
    for (Entry& entry : order_) entry.time_ns -= origin;
    if (files_[0].has_utc()) utc_ns_ = origin;
    period_ns_ = std::max(period_ns_, order_.back().time_ns + 1);
  }

  std::vector<DatFile> files_;
  std::vector<Entry> order_;
  std::array<std::uint64_t, kReceivers> packets_{};
  std::size_t next_ = 0;
  std::int64_t shift_ns_ = 0, period_ns_ = 0, utc_ns_ = 0;
  const bool loop_;
  std::vector<std::uint8_t> scratch_;
};

class McapReplay final : public PacketSource {
 public:
  McapReplay(const ReplayConfig& config, MappedFile file)
      : path_(config.files[0]), loop_(config.loop), file_(std::move(file)), reader_(open()) {
    Packet packet;
    if (!next(packet)) refuse_empty(reader_->stats().mcap.unknown_compression);
    reader_ = open();
  }

  SourceEvent poll(Nanoseconds, Packet& packet) override {
    if (!next(packet)) {
      if (!loop_) return SourceEvent::closed;
      begin_again();
      if (!next(packet)) return SourceEvent::closed;
    }
    if (round_packets_[packet.receiver]++ == 0 && first_ == SteadyTime::max()) first_ = packet.arrival;
    last_ = packet.arrival;
    packet.arrival += shift_;
    packet.arrival_utc += shift_;
    ++packets_[packet.receiver];
    return SourceEvent::packet;
  }
  Source kind() const override { return Source::replay; }
  std::string describe() const override { return "replay " + path_; }
  SourceStats stats() const override {
    SourceStats stats;
    for (std::size_t i = 0; i < kReceivers; ++i) stats.receivers[i].packets = packets_[i];
    const McapReader::Counts counts = reader_->stats().mcap;
    if (counts.bad_chunks > 0) stats.refusals.push_back({-1, "bad_chunk", counts.bad_chunks});
    if (counts.bad_records > 0) stats.refusals.push_back({-1, "bad_record", counts.bad_records});
    if (at_end_ && !counts.complete) stats.refusals.push_back({-1, "recording_cut", 1});
    return stats;
  }

 private:
  [[noreturn]] void refuse_empty(const std::string& compression) const {
    if (!compression.empty())
      throw SetupError(ExitStatus::bad_data,
                       path_ + " is compressed with " + compression +
                           ", which is not supported; write it anew with `mcap compress --compression lz4`");
    throw SetupError(ExitStatus::bad_data, path_ + " holds no CSI that csiposed or csipose has recorded");
  }
  std::unique_ptr<RecordingReader> open() const {
    return std::make_unique<RecordingReader>(file_.bytes(), path_);
  }
  bool next(Packet& packet) {
    PoseItem pose;
    for (;;) {
      const RecordingReader::Item item = reader_->next(packet, pose);
      if (item == RecordingReader::Item::packet) return true;
      if (item == RecordingReader::Item::end) return at_end_ = true, false;
    }
  }
  // The next round begins one packet's distance after the last.
  void begin_again() {
    const std::int64_t count = *std::max_element(round_packets_.begin(), round_packets_.end());
    const Nanoseconds length = last_ - first_;
    shift_ += length + (count > 1 ? length / (count - 1) : Nanoseconds(1));
    round_packets_ = {};
    at_end_ = false;
    reader_ = open();
  }

  const std::string path_;
  const bool loop_;
  const MappedFile file_;
  std::unique_ptr<RecordingReader> reader_;
  std::array<std::uint64_t, kReceivers> packets_{};
  std::array<std::int64_t, kReceivers> round_packets_{};
  SteadyTime first_ = SteadyTime::max(), last_{};
  Nanoseconds shift_{};
  bool at_end_ = false;
};

}  // namespace

std::unique_ptr<PacketSource> open_replay(const ReplayConfig& config) {
  if (config.files.empty()) throw SetupError(ExitStatus::bad_config, "no file to replay is given");
  MappedFile first(config.files[0]);
  if (McapReader(first.bytes()).is_mcap() && config.files.size() == 1)
    return std::make_unique<McapReplay>(config, std::move(first));
  if (config.files.size() > kReceivers || McapReader(first.bytes()).is_mcap())
    throw SetupError(
        ExitStatus::bad_config,
        "cannot replay these files together: give one .mcap, or one to three .dat files, one per receiver");
  return std::make_unique<DatReplay>(config);
}

}  // namespace csipose
