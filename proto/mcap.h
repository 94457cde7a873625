// proto/mcap.h - MCAP files: the open container of time-stamped messages that robotics tools read.
//
//   magic | Header | Schema* Channel* Metadata* | (Chunk MessageIndex*)* | DataEnd | summary | Footer | magic
//   record = u8 opcode, u64 length, content; little-endian; strings and maps carry u32 lengths.
//
// Messages lie in chunks of up to 1 MiB, LZ4-compressed and each with a CRC. What matters here is the crash:
// a file that was cut anywhere is read up to the last whole chunk (an unfinished chunk has no CRC yet and
// gives nothing), and a disk that is full leaves whole chunks only, because a failed write is taken back.
// Source of all format facts: https://mcap.dev/spec (version 0).
// Not here: what our recordings hold (recording.h). Not supported: zstd chunks, attachments (passed over),
// encryption.
#pragma once

#include <cstdint>
#include <map>
#include <optional>
#include <string>
#include <vector>

#include "proto/bytes.h"

namespace csipose {

using McapMap = std::map<std::string, std::string>;

struct McapSchema {
  std::uint16_t id = 0;  ///< from 1; 0 in a channel means that it has none
  std::string name, encoding;
  std::vector<std::uint8_t> data;
};
struct McapChannel {
  std::uint16_t id = 0, schema = 0;
  std::string topic, encoding;
  McapMap metadata;
};
struct McapMessage {
  std::uint16_t channel = 0;
  std::uint32_t sequence = 0;
  std::uint64_t log_time_ns = 0, publish_time_ns = 0;
  ByteView data;
};
struct McapMetadata {
  std::string name;
  McapMap values;
};

class McapWriter {
 public:
  /// Creates the file, which must not exist. Throws SetupError when it cannot.
  McapWriter(const std::string& path, const std::string& library);
  /// Closes it if that was not done.
  ~McapWriter();
  McapWriter(const McapWriter&) = delete;
  McapWriter& operator=(const McapWriter&) = delete;

  /// Before the first message. The id is given back.
  std::uint16_t add_schema(const std::string& name, const std::string& encoding, ByteView data);
  std::uint16_t add_channel(const std::string& topic, std::uint16_t schema, const std::string& encoding,
                            const McapMap& metadata);
  void add_metadata(const McapMetadata& metadata);

  /// Adds a message to the present chunk, and writes the chunk when it is full.
  /// All three: false when the disk refused, now or earlier; the file then ends after its last whole chunk,
  /// error() says why.
  bool write(const McapMessage& message);
  bool flush();  ///< writes the present chunk and waits until the disk has it
  bool close();  ///< flushes and writes the summary; nothing may follow

  const std::string& error() const { return error_; }
  std::uint64_t bytes() const { return size_ + chunk_.size(); }
  std::uint64_t unflushed_messages() const { return chunk_messages_; }

 private:
  struct ChunkIndex {
    std::uint64_t start_ns, end_ns, offset, length, index_length, compressed, uncompressed;
    std::string compression;
    std::map<std::uint16_t, std::uint64_t> index_offsets;
  };
  using MessageIndex = std::vector<std::pair<std::uint64_t, std::uint64_t>>;  // log time, place in the chunk
  using Buffer = std::vector<std::uint8_t>;

  bool put(const Buffer& bytes);
  bool fail(const char* what);
  Buffer chunk_record(ChunkIndex& index);
  Buffer summary() const;

  int fd_ = -1;
  std::string path_, error_;
  std::uint64_t size_ = 0;  // of what is whole on the disk
  std::uint32_t crc_ = 0;   // of the data section
  bool closed_ = false;
  std::vector<McapSchema> schemas_;
  std::vector<McapChannel> channels_;
  struct MetadataIndex {
    std::string name;
    std::uint64_t offset, length;
  };
  std::vector<MetadataIndex> metadata_;
  Buffer chunk_;
  std::uint64_t chunk_messages_ = 0, chunk_start_ns_ = 0, chunk_end_ns_ = 0;
  std::map<std::uint16_t, MessageIndex> chunk_index_;
  std::vector<ChunkIndex> chunks_;
  std::map<std::uint16_t, std::uint64_t> message_counts_;
};

/// Reads front to back, so that a file without an end is as good as one with.
class McapReader {
 public:
  struct Counts {
    std::uint64_t messages = 0, chunks = 0;
    std::uint64_t bad_chunks = 0;   ///< CRC wrong, damaged inside, or compressed in a way that we cannot read
    std::uint64_t bad_records = 0;  ///< outside chunks: not what their opcode says
    bool complete = false;          ///< the end of the data was reached; if not, the file was cut
    std::string unknown_compression;
  };

  /// `file` must live as long as the reader.
  explicit McapReader(ByteView file);
  bool is_mcap() const { return is_mcap_; }

  /// The next message, in file order; its data is valid until the next call. nullopt: no more.
  std::optional<McapMessage> next();

  /// What has been met so far.
  const std::map<std::uint16_t, McapSchema>& schemas() const { return schemas_; }
  const std::map<std::uint16_t, McapChannel>& channels() const { return channels_; }
  const std::vector<McapMetadata>& metadata() const { return metadata_; }
  const Counts& counts() const { return counts_; }

 private:
  struct Record {
    std::uint8_t opcode;
    ByteView content;
  };
  static std::optional<Record> take_record(ByteView bytes, std::size_t& at);
  std::optional<McapMessage> read(const Record& record, bool in_chunk);
  void open_chunk(ByteView content);
  bool unpack_chunk(ByteView content);

  ByteView file_;
  std::size_t at_ = 0;
  bool is_mcap_ = false, ended_ = false;
  std::vector<std::uint8_t> unpacked_;
  ByteView chunk_;
  std::size_t chunk_at_ = 0;
  std::map<std::uint16_t, McapSchema> schemas_;
  std::map<std::uint16_t, McapChannel> channels_;
  std::vector<McapMetadata> metadata_;
  Counts counts_;
};

}  // namespace csipose
