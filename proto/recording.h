// proto/recording.h - recordings: what the receivers sent and what the network made of it, as an MCAP file.
//
//   /csi/<receiver>   message encoding "csipose-records", no schema: the bytes of Packet::records, unchanged
//   (csitool
//                     framing: at most one 0xC1, then at most one 0xBB). Channel metadata `receiver` = 0, 1
//                     or 2.
//   /truth            message encoding "json": where simulated people really are (proto/truth.h), one object per instant
//   /pose             message encoding "protobuf", schema csipose.v1.PoseFrame (given by the caller)
//   metadata csipose  format, source, steady_origin_ns, utc_origin_ns
//
// Time. Steady arrival has to survive exactly, and readers expect UTC: so log_time is the steady line laid
// onto UTC once, at the file's first item (log_time = utc_origin + steady - steady_origin), and publish_time
// is UTC as it was then, with whatever steps it took. docs/recording.md is the page for people.
#pragma once

#include <array>
#include <cstdint>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "proto/mcap.h"
#include "proto/packet.h"
#include "proto/pose.h"

namespace csipose {

struct RecordingInfo {
  Source source = Source::live;  ///< of the packets when they were recorded
  std::array<std::string, kReceivers> receivers = {"rx1", "rx2", "rx3"};
  std::string software;  ///< name and version of the writing program
};

/// One published frame, already encoded (protobuf csipose.v1.PoseFrame).
struct PoseItem {
  ByteView frame;
  std::uint64_t seq = 0;
  SteadyTime published{};
  UtcTime published_utc{};
};

/// Where simulated people are at one instant: a JSON object as proto/truth.h encodes it, without its newline.
struct TruthItem {
  ByteView json;
  std::uint64_t counter = 0;  ///< of the transmitted packet
  SteadyTime sent{};
  UtcTime sent_utc{};
};

/// One file.
class RecordingWriter {
 public:
  /// Creates the file, which must not exist. `pose_schema` is a FileDescriptorSet; empty = no /pose channel.
  /// Throws SetupError when it cannot be made.
  RecordingWriter(const std::string& path, const RecordingInfo& info, ByteView pose_schema);

  /// All: false when the disk refuses; error() then has the words, and the file ends after its last whole
  /// chunk.
  bool add(const Packet& packet);
  bool add(const PoseItem& pose);
  bool add(const TruthItem& truth);
  bool flush() { return mcap_.flush(); }
  bool close() { return mcap_.close(); }
  const std::string& error() const { return mcap_.error(); }
  std::uint64_t bytes() const { return mcap_.bytes(); }
  std::uint64_t unflushed() const { return mcap_.unflushed_messages(); }

 private:
  bool write(std::uint16_t channel, std::uint32_t sequence, SteadyTime steady, UtcTime utc, ByteView data);

  McapWriter mcap_;
  RecordingInfo info_;
  std::array<std::uint16_t, kReceivers> csi_channels_{};
  std::array<std::uint32_t, kReceivers> csi_sequence_{};
  std::uint16_t pose_channel_ = 0;
  std::optional<std::uint16_t> truth_channel_;
  std::optional<std::int64_t> utc_minus_steady_ns_;
};

struct RecordingReaderStats {
  McapReader::Counts mcap;
  std::uint64_t foreign = 0;  ///< messages of channels that are not ours
};

/// Reads recordings front to back, whole or cut. The truth is passed over: it is for viewers and error meters.
class RecordingReader {
 public:
  /// Throws SetupError when the bytes are no MCAP file. They must live as long as the reader.
  RecordingReader(ByteView file, const std::string& name_for_words);

  enum class Item { packet, pose, end };
  /// The next item; views are valid until the next call.
  Item next(Packet& packet, PoseItem& pose);

  const RecordingInfo& info() const { return info_; }
  bool has_poses() const { return pose_channel_seen_; }
  RecordingReaderStats stats() const { return {mcap_.counts(), foreign_}; }

 private:
  void learn_channels();
  SteadyTime steady(std::uint64_t log_time_ns) const;

  McapReader mcap_;
  RecordingInfo info_;
  std::int64_t utc_minus_steady_ns_ = 0;
  std::size_t channels_known_ = 0, metadata_known_ = 0;
  std::vector<int> receiver_of_channel_;  // by channel id
  bool pose_channel_seen_ = false;
  std::uint64_t foreign_ = 0;
};

struct RecorderConfig {
  std::string folder;  ///< made when it is not there
  RecordingInfo info;
  std::string pose_schema;
  std::uint64_t rotate_bytes = 256ull << 20;       ///< 0 = never by size
  Nanoseconds rotate_age = std::chrono::hours(1);  ///< 0 = never by age
  Nanoseconds keep_age{};                          ///< older recordings of ours are removed; 0 = kept
  std::uint64_t keep_bytes = 0;  ///< the oldest are removed while all are more than this; 0 = kept
};

/// Recordings one after the other, as a daemon makes them. Used by one thread, which may wait for the disk.
///
/// A disk that refuses costs the present file's unfinished chunk; what comes is dropped and counted, and a
/// new file is tried every ten seconds. Nothing here throws.
class Recorder {
 public:
  struct Status {
    std::string file;  ///< being written; empty = none
    std::uint64_t file_bytes = 0;
    std::uint64_t files = 0, bytes = 0;
    std::uint64_t packets = 0, poses = 0;  ///< items that came
    std::uint64_t dropped = 0;             ///< of these, in no file
    std::uint64_t errors = 0;              ///< times that the disk refused
    std::string error;  ///< the last refusal, in words; empty when the present file is fine
  };

  explicit Recorder(const RecorderConfig& config);
  ~Recorder();

  /// `now` is the steady clock of the machine, which ages files and chunks (the items' own times may be a
  /// recording's).
  void add(const Packet& packet, SteadyTime now);
  void add(const PoseItem& pose, SteadyTime now);
  /// Call at least twice a second: what is a second old goes to the disk.
  void tick(SteadyTime now);
  /// Ends the present file; the next item begins a new one.
  void rotate();
  Status status() const;

 private:
  template <class ItemType>
  void add_item(const ItemType& item, UtcTime utc, SteadyTime now, std::uint64_t& counter);
  bool open(UtcTime utc, SteadyTime now);
  void failed(const std::string& words, SteadyTime now);
  void remove_old() const;

  RecorderConfig config_;
  std::unique_ptr<RecordingWriter> writer_;
  SteadyTime opened_{}, flushed_{};
  std::optional<SteadyTime> retry_at_;
  Status status_;
};

}  // namespace csipose
