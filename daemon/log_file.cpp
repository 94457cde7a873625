#include "daemon/log_file.h"

#include <array>
#include <cstring>
#include <string_view>

#include "capture/dat_file.h"
#include "proto/recording.h"

namespace csipose {
namespace {

class DatLog : public LogFile {
 public:
  DatLog(MappedFile file, std::string name) : file_(std::move(file)), name_(std::move(name)) {}
  std::vector<std::string> receivers() const override { return {name_}; }
  std::uint64_t bytes() const override { return file_.bytes().size(); }
  bool is_recording() const override { return false; }

  LogCounts for_each(std::size_t, RecordStream::Policy policy, const Visitor& visit) const override {
    LogCounts counts;
    RecordStream stream(file_.bytes(), policy);
    for (bool more = true; more;) {
      const std::optional<RawRecord> record = stream.next();
      if (stream.fault()) counts.faults.push_back(*stream.fault());
      if (record) visit({*record, std::nullopt});
      more = record.has_value();
    }
    counts.records = stream.counts();
    return counts;
  }

 private:
  MappedFile file_;
  std::string name_;
};

class RecordingLog : public LogFile {
 public:
  RecordingLog(MappedFile file, std::string path) : file_(std::move(file)), path_(std::move(path)) {
    RecordingReader reader(file_.bytes(), path_);
    Packet packet;
    PoseItem pose;
    std::array<bool, kReceivers> heard{};
    for (auto item = reader.next(packet, pose); item != RecordingReader::Item::end;
         item = reader.next(packet, pose))
      if (item == RecordingReader::Item::packet) heard[packet.receiver] = true;
    for (std::size_t receiver = 0; receiver < kReceivers; ++receiver)
      if (heard[receiver])
        receivers_.push_back(receiver), names_.push_back(reader.info().receivers[receiver]);
  }
  std::vector<std::string> receivers() const override { return names_; }
  std::uint64_t bytes() const override { return file_.bytes().size(); }
  bool is_recording() const override { return true; }

  /// A packet holds whole records: it is read strictly, whatever the policy.
  LogCounts for_each(std::size_t receiver, RecordStream::Policy, const Visitor& visit) const override {
    LogCounts counts;
    RecordingReader reader(file_.bytes(), path_);
    Packet packet;
    PoseItem pose;
    for (auto item = reader.next(packet, pose); item != RecordingReader::Item::end;
         item = reader.next(packet, pose)) {
      counts.poses += item == RecordingReader::Item::pose;
      if (item != RecordingReader::Item::packet || packet.receiver != receivers_[receiver]) continue;
      RecordStream stream(packet.records, RecordStream::Policy::strict);
      while (const auto record = stream.next()) visit({*record, packet.arrival});
      counts.records += stream.counts();
    }
    counts.is_cut = !reader.stats().mcap.complete;
    counts.bad_chunks = reader.stats().mcap.bad_chunks;
    return counts;
  }

 private:
  MappedFile file_;
  std::string path_;
  std::vector<std::size_t> receivers_;  // their index in the recording
  std::vector<std::string> names_;
};

bool begins_as_mcap(ByteView bytes) {
  static constexpr std::string_view kMagic = "\x89MCAP";
  return bytes.size() >= kMagic.size() && std::memcmp(bytes.data(), kMagic.data(), kMagic.size()) == 0;
}

}  // namespace

std::unique_ptr<LogFile> open_log(const std::string& path) {
  MappedFile file(path);
  if (begins_as_mcap(file.bytes())) return std::make_unique<RecordingLog>(std::move(file), path);
  return std::make_unique<DatLog>(std::move(file), path);
}

}  // namespace csipose
