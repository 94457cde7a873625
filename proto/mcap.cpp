#include "proto/mcap.h"

#include <fcntl.h>
#include <lz4frame.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <cassert>
#include <cerrno>
#include <cstring>

#include "proto/crc32.h"
#include "proto/result.h"

namespace csipose {
namespace {

using Buffer = std::vector<std::uint8_t>;
constexpr std::array<std::uint8_t, 8> kMagic = {0x89, 'M', 'C', 'A', 'P', '0', '\r', '\n'};
constexpr std::size_t kChunkBytes = 1 << 20;
constexpr std::size_t kMaxChunk = 128 << 20;  // of a foreign file, unpacked
constexpr std::size_t kMaxLz4Ratio = 255;     // LZ4 cannot pack tighter
constexpr std::size_t kRecordHeader = 9, kMaxMetadata = 64;

enum Opcode : std::uint8_t {
  kHeader = 1,
  kFooter,
  kSchema,
  kChannel,
  kMessage,
  kChunk,
  kMessageIndex,
  kChunkIndex,
  kAttachment,
  kAttachmentIndex,
  kStatistics,
  kMetadata,
  kMetadataIndex,
  kSummaryOffset,
  kDataEnd
};

// ---- writing

template <class Integer>
void put_int(Buffer& to, Integer value) {
  to.resize(to.size() + sizeof value);
  store_le<Integer>(to.data() + to.size() - sizeof value, value);
}
void put_bytes(Buffer& to, ByteView bytes) { to.insert(to.end(), bytes.begin(), bytes.end()); }
void put_string(Buffer& to, const std::string& text) {
  put_int(to, static_cast<std::uint32_t>(text.size()));
  put_bytes(to, text);
}

// Runs `fill`, which appends, and stores before it how many bytes it has appended.
template <class Length, class Fill>
void put_sized(Buffer& to, const Fill& fill) {
  const std::size_t at = to.size();
  put_int<Length>(to, 0);
  fill();
  store_le<Length>(to.data() + at, static_cast<Length>(to.size() - at - sizeof(Length)));
}
template <class Fill>
void put_record(Buffer& to, Opcode opcode, const Fill& fill) {
  to.push_back(opcode);
  put_sized<std::uint64_t>(to, fill);
}
void put_map(Buffer& to, const McapMap& map) {
  put_sized<std::uint32_t>(to, [&] {
    for (const auto& [key, value] : map) put_string(to, key), put_string(to, value);
  });
}
void put_map(Buffer& to, const std::map<std::uint16_t, std::uint64_t>& map) {
  put_sized<std::uint32_t>(to, [&] {
    for (const auto& [key, value] : map) put_int(to, key), put_int(to, value);
  });
}

void put_schema(Buffer& to, const McapSchema& schema) {
  put_record(to, kSchema, [&] {
    put_int(to, schema.id);
    put_string(to, schema.name);
    put_string(to, schema.encoding);
    put_int(to, static_cast<std::uint32_t>(schema.data.size()));
    put_bytes(to, schema.data);
  });
}
void put_channel(Buffer& to, const McapChannel& channel) {
  put_record(to, kChannel, [&] {
    put_int(to, channel.id);
    put_int(to, channel.schema);
    put_string(to, channel.topic);
    put_string(to, channel.encoding);
    put_map(to, channel.metadata);
  });
}

Buffer pack_lz4(ByteView bytes) {
  LZ4F_preferences_t preferences{};
  preferences.frameInfo.contentSize = bytes.size();
  Buffer packed(LZ4F_compressFrameBound(bytes.size(), &preferences));
  const std::size_t size =
      LZ4F_compressFrame(packed.data(), packed.size(), bytes.data(), bytes.size(), &preferences);
  packed.resize(LZ4F_isError(size) ? 0 : size);
  return packed;
}

// ---- reading

// Takes fields off the front; after the first that is not there, ok() is false and all are empty.
class Cursor {
 public:
  explicit Cursor(ByteView bytes) : bytes_(bytes) {}
  template <class Integer>
  Integer integer() {
    const ByteView field = bytes(sizeof(Integer));
    return ok_ ? load_le<Integer>(field.data()) : Integer{};
  }
  ByteView bytes(std::uint64_t size) {
    ok_ = ok_ && size <= bytes_.size();
    if (!ok_) return {};
    const ByteView taken = bytes_.sub(0, size);
    bytes_ = bytes_.sub(size);
    return taken;
  }
  ByteView sized32() { return bytes(integer<std::uint32_t>()); }
  std::string string() {
    const ByteView text = sized32();
    return {text.begin(), text.end()};
  }
  McapMap map() {
    Cursor inside(sized32());
    McapMap map;
    while (inside.ok_ && !inside.bytes_.empty()) {
      std::string key = inside.string();
      std::string value = inside.string();
      if (inside.ok_) map[std::move(key)] = std::move(value);
    }
    ok_ = ok_ && inside.ok_;
    return map;
  }
  ByteView rest() { return bytes(bytes_.size()); }
  bool ok() const { return ok_; }

 private:
  ByteView bytes_;
  bool ok_ = true;
};

bool unpack_lz4(ByteView packed, Buffer& out) {
  LZ4F_dctx* context = nullptr;
  if (LZ4F_isError(LZ4F_createDecompressionContext(&context, LZ4F_VERSION))) return false;
  std::size_t in = 0, filled = 0, hint = 1;
  while (hint != 0 && in < packed.size()) {
    std::size_t out_size = out.size() - filled, in_size = packed.size() - in;
    hint = LZ4F_decompress(context, out.data() + filled, &out_size, packed.data() + in, &in_size, nullptr);
    if (LZ4F_isError(hint) || (out_size == 0 && in_size == 0)) break;
    in += in_size;
    filled += out_size;
  }
  LZ4F_freeDecompressionContext(context);
  return hint == 0 && filled == out.size();
}

}  // namespace

McapWriter::McapWriter(const std::string& path, const std::string& library) : path_(path) {
  fd_ = ::open(path.c_str(), O_WRONLY | O_CREAT | O_EXCL | O_CLOEXEC, 0640);
  if (fd_ < 0)
    throw SetupError(errno == EACCES ? ExitStatus::no_permission : ExitStatus::cannot_create,
                     "cannot make the recording " + path + ": " + std::strerror(errno));
  Buffer start(kMagic.begin(), kMagic.end());
  put_record(start, kHeader, [&] {
    put_string(start, "");
    put_string(start, library);
  });
  put(start);
}

McapWriter::~McapWriter() {
  close();
  ::close(fd_);
}

bool McapWriter::fail(const char* what) {
  const int error = errno;
  if (error_.empty())
    error_ = "recording " + path_ + " ends here, whole up to its last chunk: " + what + ": " +
             std::strerror(error) +
             (error == ENOSPC || error == EDQUOT || error == EFBIG ? "; make room on the disk" : "");
  return false;
}

// All of it or nothing: what a failed write has left is cut off again.
bool McapWriter::put(const Buffer& bytes) {
  if (!error_.empty()) return false;
  for (std::size_t done = 0; done < bytes.size();) {
    const ssize_t size = ::write(fd_, bytes.data() + done, bytes.size() - done);
    if (size < 0 && errno == EINTR) continue;
    if (size <= 0) {
      fail("the disk refused a write");
      if (::ftruncate(fd_, static_cast<off_t>(size_)) == 0) ::lseek(fd_, static_cast<off_t>(size_), SEEK_SET);
      return false;
    }
    done += static_cast<std::size_t>(size);
  }
  size_ += bytes.size();
  crc_ = crc32(bytes, crc_);
  return true;
}

std::uint16_t McapWriter::add_schema(const std::string& name, const std::string& encoding, ByteView data) {
  schemas_.push_back(
      {static_cast<std::uint16_t>(schemas_.size() + 1), name, encoding, {data.begin(), data.end()}});
  Buffer record;
  put_schema(record, schemas_.back());
  put(record);
  return schemas_.back().id;
}

std::uint16_t McapWriter::add_channel(const std::string& topic, std::uint16_t schema,
                                      const std::string& encoding, const McapMap& metadata) {
  channels_.push_back({static_cast<std::uint16_t>(channels_.size() + 1), schema, topic, encoding, metadata});
  Buffer record;
  put_channel(record, channels_.back());
  put(record);
  return channels_.back().id;
}

void McapWriter::add_metadata(const McapMetadata& metadata) {
  Buffer record;
  put_record(record, kMetadata, [&] {
    put_string(record, metadata.name);
    put_map(record, metadata.values);
  });
  metadata_.push_back({metadata.name, size_, record.size()});
  put(record);
}

bool McapWriter::write(const McapMessage& message) {
  assert(!closed_ && message.channel >= 1 && message.channel <= channels_.size());
  chunk_index_[message.channel].emplace_back(message.log_time_ns, chunk_.size());
  chunk_start_ns_ =
      chunk_messages_ == 0 ? message.log_time_ns : std::min(chunk_start_ns_, message.log_time_ns);
  chunk_end_ns_ = chunk_messages_ == 0 ? message.log_time_ns : std::max(chunk_end_ns_, message.log_time_ns);
  ++chunk_messages_;
  put_record(chunk_, kMessage, [&] {
    put_int(chunk_, message.channel);
    put_int(chunk_, message.sequence);
    put_int(chunk_, message.log_time_ns);
    put_int(chunk_, message.publish_time_ns);
    put_bytes(chunk_, message.data);
  });
  return error_.empty() && (chunk_.size() < kChunkBytes || flush());
}

// The chunk and, after it, one MessageIndex per channel; `index` learns where they will lie.
McapWriter::Buffer McapWriter::chunk_record(ChunkIndex& index) {
  Buffer packed = pack_lz4(chunk_), record;
  const bool worth_it = !packed.empty() && packed.size() < chunk_.size();
  index = {chunk_start_ns_, chunk_end_ns_,         size_, 0, 0, worth_it ? packed.size() : chunk_.size(),
           chunk_.size(),   worth_it ? "lz4" : "", {}};
  put_record(record, kChunk, [&] {
    put_int(record, chunk_start_ns_);
    put_int(record, chunk_end_ns_);
    put_int(record, static_cast<std::uint64_t>(chunk_.size()));
    put_int(record, crc32(chunk_));
    put_string(record, index.compression);
    put_int(record, index.compressed);
    put_bytes(record, worth_it ? packed : chunk_);
  });
  index.length = record.size();
  for (const auto& channel : chunk_index_) {
    index.index_offsets[channel.first] = size_ + record.size();
    put_record(record, kMessageIndex, [&] {
      put_int(record, channel.first);
      put_sized<std::uint32_t>(record, [&] {
        for (const auto& [time, place] : channel.second) put_int(record, time), put_int(record, place);
      });
    });
  }
  index.index_length = record.size() - index.length;
  return record;
}

bool McapWriter::flush() {
  if (chunk_messages_ == 0 || !error_.empty()) return error_.empty();
  ChunkIndex index;
  if (!put(chunk_record(index))) return false;
  chunks_.push_back(index);
  for (const auto& [channel, entries] : chunk_index_) message_counts_[channel] += entries.size();
  chunk_index_.clear();
  chunk_.clear();
  chunk_messages_ = 0;
  return ::fdatasync(fd_) == 0 || fail("the disk did not take what was written");
}

bool McapWriter::close() {
  if (closed_) return error_.empty();
  const bool flushed = flush();
  closed_ = true;
  if (!flushed) return false;
  Buffer end;
  put_record(end, kDataEnd, [&] { put_int(end, crc_); });
  if (!put(end)) return false;
  return put(summary()) && (::fsync(fd_) == 0 || fail("the disk did not take what was written"));
}

McapWriter::Buffer McapWriter::summary() const {
  Buffer out, offsets;
  const auto group = [&](Opcode opcode, const auto& fill) {
    const std::uint64_t start = size_ + out.size();
    fill();
    const std::uint64_t length = size_ + out.size() - start;
    if (length == 0) return;
    put_record(offsets, kSummaryOffset, [&] {
      offsets.push_back(opcode);
      put_int(offsets, start);
      put_int(offsets, length);
    });
  };
  group(kSchema, [&] {
    for (const McapSchema& schema : schemas_) put_schema(out, schema);
  });
  group(kChannel, [&] {
    for (const McapChannel& channel : channels_) put_channel(out, channel);
  });
  group(kStatistics, [&] {
    std::uint64_t messages = 0, first = chunks_.empty() ? 0 : UINT64_MAX, last = 0;
    for (const auto& [channel, count] : message_counts_) messages += count;
    for (const ChunkIndex& c : chunks_) first = std::min(first, c.start_ns), last = std::max(last, c.end_ns);
    put_record(out, kStatistics, [&] {
      put_int(out, messages);
      put_int(out, static_cast<std::uint16_t>(schemas_.size()));
      put_int(out, static_cast<std::uint32_t>(channels_.size()));
      put_int(out, std::uint32_t{0});  // attachments
      put_int(out, static_cast<std::uint32_t>(metadata_.size()));
      put_int(out, static_cast<std::uint32_t>(chunks_.size()));
      put_int(out, first);
      put_int(out, last);
      put_map(out, message_counts_);
    });
  });
  group(kChunkIndex, [&] {
    for (const ChunkIndex& c : chunks_)
      put_record(out, kChunkIndex, [&] {
        for (const std::uint64_t value : {c.start_ns, c.end_ns, c.offset, c.length}) put_int(out, value);
        put_map(out, c.index_offsets);
        put_int(out, c.index_length);
        put_string(out, c.compression);
        put_int(out, c.compressed);
        put_int(out, c.uncompressed);
      });
  });
  group(kMetadataIndex, [&] {
    for (const MetadataIndex& m : metadata_)
      put_record(out, kMetadataIndex, [&] {
        put_int(out, m.offset);
        put_int(out, m.length);
        put_string(out, m.name);
      });
  });
  const std::uint64_t summary_start = size_, offsets_start = size_ + out.size();
  put_bytes(out, offsets);
  put_record(out, kFooter, [&] {
    put_int(out, summary_start);
    put_int(out, offsets_start);
    // Over the summary and the footer up to here; the record's length is known: 20.
    store_le<std::uint64_t>(out.data() + out.size() - 24, 20);
    put_int(out, crc32(out));
  });
  put_bytes(out, kMagic);
  return out;
}

McapReader::McapReader(ByteView file) : file_(file), at_(kMagic.size()) {
  is_mcap_ = file.size() >= kMagic.size() && std::equal(kMagic.begin(), kMagic.end(), file.begin());
  ended_ = !is_mcap_;
}

std::optional<McapReader::Record> McapReader::take_record(ByteView bytes, std::size_t& at) {
  Cursor cursor(bytes.sub(at));
  const auto opcode = cursor.integer<std::uint8_t>();
  const auto length = cursor.integer<std::uint64_t>();
  const ByteView content = cursor.bytes(length);
  if (!cursor.ok()) return std::nullopt;
  at += kRecordHeader + content.size();
  return Record{opcode, content};
}

std::optional<McapMessage> McapReader::next() {
  while (!ended_) {
    const bool in_chunk = chunk_at_ < chunk_.size();
    const auto record = in_chunk ? take_record(chunk_, chunk_at_) : take_record(file_, at_);
    if (!record && in_chunk) {  // its CRC fits, so whoever wrote it did so wrongly
      ++counts_.bad_chunks;
      chunk_at_ = chunk_.size();
      continue;
    }
    if (!record || (!in_chunk && record->opcode == kDataEnd)) {
      counts_.complete = record.has_value();
      ended_ = true;
      break;
    }
    if (const auto message = read(*record, in_chunk)) {
      ++counts_.messages;
      return message;
    }
  }
  return std::nullopt;
}

std::optional<McapMessage> McapReader::read(const Record& record, bool in_chunk) {
  Cursor c(record.content);
  if (record.opcode == kSchema) {
    McapSchema schema{c.integer<std::uint16_t>(), c.string(), c.string(), {}};
    const ByteView data = c.sized32();
    schema.data.assign(data.begin(), data.end());
    if (c.ok()) schemas_[schema.id] = std::move(schema);
  } else if (record.opcode == kChannel) {
    McapChannel channel{c.integer<std::uint16_t>(), c.integer<std::uint16_t>(), c.string(), c.string(),
                        c.map()};
    if (c.ok()) channels_[channel.id] = std::move(channel);
  } else if (record.opcode == kMetadata) {
    McapMetadata metadata{c.string(), c.map()};
    if (c.ok() && metadata_.size() < kMaxMetadata) metadata_.push_back(std::move(metadata));
  } else if (record.opcode == kMessage) {
    const McapMessage message{c.integer<std::uint16_t>(), c.integer<std::uint32_t>(),
                              c.integer<std::uint64_t>(), c.integer<std::uint64_t>(), c.rest()};
    if (c.ok() && channels_.count(message.channel) > 0) return message;
    ++counts_.bad_records;
    return std::nullopt;
  } else if (record.opcode == kChunk && !in_chunk) {
    open_chunk(record.content);
  }
  if (!c.ok()) ++counts_.bad_records;
  return std::nullopt;
}

void McapReader::open_chunk(ByteView content) {
  ++counts_.chunks;
  chunk_at_ = 0;
  if (unpack_chunk(content)) return;
  ++counts_.bad_chunks;
  chunk_ = {};
}

bool McapReader::unpack_chunk(ByteView content) {
  Cursor c(content);
  c.bytes(16);  // first and last log time
  const auto size = c.integer<std::uint64_t>();
  const auto crc = c.integer<std::uint32_t>();
  const std::string compression = c.string();
  const ByteView packed = c.bytes(c.integer<std::uint64_t>());
  if (!c.ok()) return false;
  if (compression.empty()) {
    chunk_ = packed;
  } else if (compression == "lz4") {
    if (size > kMaxChunk || size > kMaxLz4Ratio * packed.size()) return false;
    unpacked_.resize(size);
    if (!unpack_lz4(packed, unpacked_)) return false;
    chunk_ = unpacked_;
  } else {
    counts_.unknown_compression = compression;
    return false;
  }
  return chunk_.size() == size && (crc == 0 || crc32(chunk_) == crc);  // 0: its writer did not compute one
}

}  // namespace csipose
