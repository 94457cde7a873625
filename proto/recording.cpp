#include "proto/recording.h"

#include <time.h>

#include <algorithm>
#include <cassert>
#include <charconv>
#include <filesystem>
#include <system_error>

#include "proto/result.h"

namespace csipose {
namespace {

namespace fs = std::filesystem;
constexpr const char* kRecordsEncoding = "csipose-records";
constexpr const char* kFormat = "1";
constexpr auto kFlushEvery =
    std::chrono::milliseconds(500);  // with a tick every half second: a second at the most
constexpr auto kRetryAfter = std::chrono::seconds(10);
constexpr int kForeign = -1, kPose = -2, kTruth = -3;  // in place of a receiver

const char* word_of(Source source) {
  return source == Source::simulated ? "simulated" : source == Source::replay ? "replay" : "live";
}
Source source_of(const std::string& word) {
  return word == "simulated" ? Source::simulated : word == "replay" ? Source::replay : Source::live;
}

std::optional<std::int64_t> integer_of(const McapMap& map, const char* key) {
  const auto found = map.find(key);
  if (found == map.end()) return std::nullopt;
  std::int64_t value = 0;
  const char* const end = found->second.data() + found->second.size();
  const auto [rest, error] = std::from_chars(found->second.data(), end, value);
  return error == std::errc{} && rest == end ? std::optional(value) : std::nullopt;
}

// csipose-2026-11-22T03-15-00Z
std::string name_for(UtcTime utc) {
  const time_t s = static_cast<time_t>(ns(utc) / 1'000'000'000);
  tm parts{};
  gmtime_r(&s, &parts);
  char text[64];
  strftime(text, sizeof text, "csipose-%Y-%m-%dT%H-%M-%SZ", &parts);
  return text;
}

std::string free_path(const std::string& folder, UtcTime utc) {
  const std::string stem = folder + "/" + name_for(utc);
  std::string path = stem + ".mcap";
  for (int n = 2; fs::exists(path) && n < 10'000; ++n) path = stem + "-" + std::to_string(n) + ".mcap";
  return path;
}

bool is_ours(const fs::directory_entry& entry) {
  std::error_code ignored;
  return entry.is_regular_file(ignored) && entry.path().extension() == ".mcap" &&
         entry.path().filename().string().rfind("csipose-", 0) == 0;
}

}  // namespace

RecordingWriter::RecordingWriter(const std::string& path, const RecordingInfo& info, ByteView pose_schema)
    : mcap_(path, info.software), info_(info) {
  for (std::size_t i = 0; i < kReceivers; ++i)
    csi_channels_[i] = mcap_.add_channel("/csi/" + info.receivers[i], 0, kRecordsEncoding,
                                         {{"receiver", std::to_string(i)}});
  if (pose_schema.empty()) return;
  const std::uint16_t schema = mcap_.add_schema("csipose.v1.PoseFrame", "protobuf", pose_schema);
  pose_channel_ = mcap_.add_channel("/pose", schema, "protobuf", {});
}

bool RecordingWriter::add(const Packet& packet) {
  return write(csi_channels_[packet.receiver], csi_sequence_[packet.receiver]++, packet.arrival,
               packet.arrival_utc, packet.records);
}

bool RecordingWriter::add(const PoseItem& pose) {
  assert(pose_channel_ != 0);
  return write(pose_channel_, static_cast<std::uint32_t>(pose.seq), pose.published, pose.published_utc,
               pose.frame);
}

bool RecordingWriter::add(const TruthItem& truth) {
  if (!truth_channel_) truth_channel_ = mcap_.add_channel("/truth", 0, "json", {});
  return write(*truth_channel_, static_cast<std::uint32_t>(truth.counter), truth.sent, truth.sent_utc,
               truth.json);
}

bool RecordingWriter::write(std::uint16_t channel, std::uint32_t sequence, SteadyTime steady, UtcTime utc,
                            ByteView data) {
  if (!utc_minus_steady_ns_) {
    utc_minus_steady_ns_ = ns(utc) - ns(steady);
    mcap_.add_metadata({"csipose",
                        {{"format", kFormat},
                         {"source", word_of(info_.source)},
                         {"steady_origin_ns", std::to_string(ns(steady))},
                         {"utc_origin_ns", std::to_string(ns(utc))}}});
  }
  return mcap_.write({channel, sequence, static_cast<std::uint64_t>(ns(steady) + *utc_minus_steady_ns_),
                      static_cast<std::uint64_t>(ns(utc)), data});
}

RecordingReader::RecordingReader(ByteView file, const std::string& name) : mcap_(file) {
  if (!mcap_.is_mcap())
    throw SetupError(ExitStatus::bad_data,
                     name + " is not a recording: it does not begin as an MCAP file does");
  receiver_of_channel_.assign(65'536, kForeign);
}

// Channels and metadata come before the messages that need them, but may come late in the files of others.
void RecordingReader::learn_channels() {
  for (; metadata_known_ < mcap_.metadata().size(); ++metadata_known_) {
    const McapMetadata& metadata = mcap_.metadata()[metadata_known_];
    if (metadata.name != "csipose") continue;
    const auto steady = integer_of(metadata.values, "steady_origin_ns"),
               utc = integer_of(metadata.values, "utc_origin_ns");
    // Unsigned: a damaged origin may be anything.
    if (steady && utc)
      utc_minus_steady_ns_ =
          static_cast<std::int64_t>(static_cast<std::uint64_t>(*utc) - static_cast<std::uint64_t>(*steady));
    const auto source = metadata.values.find("source");
    if (source != metadata.values.end()) info_.source = source_of(source->second);
  }
  if (channels_known_ == mcap_.channels().size()) return;
  channels_known_ = mcap_.channels().size();
  for (const auto& [id, channel] : mcap_.channels()) {
    const auto receiver = integer_of(channel.metadata, "receiver");
    const bool is_csi = channel.encoding == kRecordsEncoding && receiver && *receiver >= 0 &&
                        *receiver < std::int64_t{kReceivers};
    const bool is_pose = channel.topic == "/pose" && channel.encoding == "protobuf";
    const bool is_truth = channel.topic == "/truth" && channel.encoding == "json";
    receiver_of_channel_[id] = is_csi     ? static_cast<int>(*receiver)
                               : is_pose  ? kPose
                               : is_truth ? kTruth
                                          : kForeign;
    if (is_csi && channel.topic.rfind("/csi/", 0) == 0)
      info_.receivers[static_cast<std::size_t>(*receiver)] = channel.topic.substr(5);
    pose_channel_seen_ = pose_channel_seen_ || is_pose;
  }
}

SteadyTime RecordingReader::steady(std::uint64_t log_time_ns) const {
  return SteadyTime(
      Nanoseconds(static_cast<std::int64_t>(log_time_ns - static_cast<std::uint64_t>(utc_minus_steady_ns_))));
}

RecordingReader::Item RecordingReader::next(Packet& packet, PoseItem& pose) {
  while (const auto message = mcap_.next()) {
    learn_channels();
    const int receiver = receiver_of_channel_[message->channel];
    const UtcTime utc{Nanoseconds(static_cast<std::int64_t>(message->publish_time_ns))};
    if (receiver == kPose) {
      pose = {message->data, message->sequence, steady(message->log_time_ns), utc};
      return Item::pose;
    }
    if (receiver >= 0) {
      packet = {static_cast<std::uint8_t>(receiver), steady(message->log_time_ns), utc, message->data};
      return Item::packet;
    }
    if (receiver == kForeign) ++foreign_;
  }
  return Item::end;
}

Recorder::Recorder(const RecorderConfig& config) : config_(config) { remove_old(); }
Recorder::~Recorder() { rotate(); }

void Recorder::add(const Packet& packet, SteadyTime now) {
  add_item(packet, packet.arrival_utc, now, status_.packets);
}
void Recorder::add(const PoseItem& pose, SteadyTime now) {
  add_item(pose, pose.published_utc, now, status_.poses);
}

template <class ItemType>
void Recorder::add_item(const ItemType& item, UtcTime utc, SteadyTime now, std::uint64_t& counter) {
  ++counter;
  if (!writer_ && !open(utc, now)) {
    ++status_.dropped;
    return;
  }
  if (!writer_->add(item)) return failed(writer_->error(), now);
  if (config_.rotate_bytes > 0 && writer_->bytes() >= config_.rotate_bytes) rotate();
}

bool Recorder::open(UtcTime utc, SteadyTime now) {
  if (retry_at_ && now < *retry_at_) return false;
  try {
    fs::create_directories(config_.folder);
    const std::string path = free_path(config_.folder, utc);
    writer_ = std::make_unique<RecordingWriter>(path, config_.info, config_.pose_schema);
    status_.file = path;
  } catch (const std::exception& error) {  // the set-up is wrong, but a daemon goes on without its recording
    failed(error.what(), now);
    return false;
  }
  ++status_.files;
  status_.error.clear();
  retry_at_.reset();
  opened_ = flushed_ = now;
  remove_old();
  return true;
}

void Recorder::failed(const std::string& words, SteadyTime now) {
  if (writer_) status_.dropped += writer_->unflushed();
  writer_.reset();
  status_.file.clear();
  status_.error = words;
  ++status_.errors;
  retry_at_ = now + kRetryAfter;
}

void Recorder::tick(SteadyTime now) {
  if (!writer_) return;
  if (config_.rotate_age > Nanoseconds::zero() && now - opened_ >= config_.rotate_age) return rotate();
  if (now - flushed_ < kFlushEvery) return;
  flushed_ = now;
  if (!writer_->flush()) failed(writer_->error(), now);
}

void Recorder::rotate() {
  if (!writer_) return;
  if (!writer_->close()) {
    status_.error = writer_->error();
    status_.dropped += writer_->unflushed();
    ++status_.errors;
  }
  status_.bytes += writer_->bytes();
  writer_.reset();
  status_.file.clear();
}

Recorder::Status Recorder::status() const {
  Status status = status_;
  status.file_bytes = writer_ ? writer_->bytes() : 0;
  status.bytes += status.file_bytes;
  return status;
}

void Recorder::remove_old() const {
  std::vector<std::pair<fs::file_time_type, fs::path>> files;
  std::uint64_t total = 0;
  std::error_code error;
  for (const auto& entry : fs::directory_iterator(config_.folder, error)) {
    if (!is_ours(entry) || entry.path() == status_.file) continue;
    files.emplace_back(entry.last_write_time(error), entry.path());
    total += entry.file_size(error);
  }
  std::sort(files.begin(), files.end());
  const auto oldest = fs::file_time_type::clock::now() - config_.keep_age;
  for (const auto& [written, path] : files) {
    const bool too_old = config_.keep_age > Nanoseconds::zero() && written < oldest;
    const bool too_many = config_.keep_bytes > 0 && total > config_.keep_bytes;
    if (!too_old && !too_many) continue;
    total -= std::min<std::uint64_t>(total, fs::file_size(path, error));
    fs::remove(path, error);
  }
}

}  // namespace csipose
