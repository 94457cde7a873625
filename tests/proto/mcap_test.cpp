// That other programs read our files, and we theirs, was tried with the mcap package for Python
// (docs/recording.md).
#include "proto/mcap.h"

#include <gtest/gtest.h>
#include <sys/resource.h>

#include <algorithm>
#include <csignal>
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <iterator>
#include <random>

#include "proto/crc32.h"
#include "proto/result.h"

namespace csipose {
namespace {

using Bytes = std::vector<std::uint8_t>;

struct Message {
  std::uint16_t channel;
  std::uint32_t sequence;
  std::uint64_t log_time_ns, publish_time_ns;
  Bytes data;
  bool operator==(const Message& o) const {
    return channel == o.channel && sequence == o.sequence && log_time_ns == o.log_time_ns &&
           publish_time_ns == o.publish_time_ns && data == o.data;
  }
};

class Mcap : public ::testing::Test {
 protected:
  Mcap() {
    std::string pattern = ::testing::TempDir() + "csipose-mcap-XXXXXX";
    folder_ = mkdtemp(pattern.data());
  }
  ~Mcap() override { std::filesystem::remove_all(folder_); }
  std::string path() const { return folder_ + "/a.mcap"; }
  Bytes bytes() const {
    std::ifstream file(path(), std::ios::binary);
    return {std::istreambuf_iterator<char>(file), {}};
  }
  static std::vector<Message> read(const Bytes& file, McapReader::Counts* counts = nullptr) {
    McapReader reader(file);
    std::vector<Message> messages;
    while (const auto m = reader.next())
      messages.push_back({m->channel, m->sequence, m->log_time_ns, m->publish_time_ns,
                          Bytes(m->data.begin(), m->data.end())});
    if (counts != nullptr) *counts = reader.counts();
    return messages;
  }
  // Messages of two channels; a chunk ends after every `per_chunk`.
  std::vector<Message> write(int count, int per_chunk, std::size_t size = 50) {
    std::vector<Message> messages;
    McapWriter writer(path(), "test");
    const std::uint16_t schema = writer.add_schema("name", "protobuf", Bytes{1, 2, 3});
    writer.add_channel("/a", 0, "raw", {{"receiver", "0"}});
    writer.add_channel("/b", schema, "protobuf", {});
    writer.add_metadata({"csipose", {{"key", "value"}}});
    std::mt19937_64 random(1);
    for (int i = 0; i < count; ++i) {
      Bytes data(random() % (2 * size));
      for (auto& byte : data) byte = static_cast<std::uint8_t>(random() % 7);
      messages.push_back(
          {static_cast<std::uint16_t>(1 + i % 2), static_cast<std::uint32_t>(i), random(), random(), data});
      const Message& m = messages.back();
      EXPECT_TRUE(writer.write({m.channel, m.sequence, m.log_time_ns, m.publish_time_ns, m.data}));
      const bool chunk_ends = i % per_chunk == per_chunk - 1;
      EXPECT_TRUE(!chunk_ends || writer.flush());
    }
    EXPECT_TRUE(writer.close());
    EXPECT_EQ(writer.bytes(), std::filesystem::file_size(path()));
    return messages;
  }
  std::string folder_;
};

TEST_F(Mcap, GivesBackWhatWasWritten) {
  const auto written = write(1000, 70);
  McapReader::Counts counts;
  EXPECT_EQ(read(bytes(), &counts), written);
  EXPECT_EQ(counts.messages, 1000u);
  EXPECT_EQ(counts.chunks, 15u);
  EXPECT_EQ(counts.bad_chunks + counts.bad_records, 0u);
  EXPECT_TRUE(counts.complete);

  const Bytes file = bytes();
  McapReader reader(file);
  while (reader.next()) {
  }
  EXPECT_EQ(reader.channels().at(1).topic, "/a");
  EXPECT_EQ(reader.channels().at(1).metadata.at("receiver"), "0");
  EXPECT_EQ(reader.channels().at(2).schema, 1);
  EXPECT_EQ(reader.schemas().at(1).data, (Bytes{1, 2, 3}));
  ASSERT_EQ(reader.metadata().size(), 1u);
  EXPECT_EQ(reader.metadata()[0].values.at("key"), "value");
}

TEST_F(Mcap, LargeMessagesFillChunksByThemselves) {
  const auto written = write(400, 1'000'000, 20'000);
  McapReader::Counts counts;
  EXPECT_EQ(read(bytes(), &counts), written);
  EXPECT_GE(counts.chunks, 7u);
}

TEST_F(Mcap, CutAnywhereItReadsWholeChunks) {
  const auto written = write(40, 10, 20);
  const Bytes whole = bytes();
  std::size_t longest = 0;
  for (std::size_t size = 8; size < whole.size(); ++size) {
    McapReader::Counts counts;
    const auto messages = read({whole.begin(), whole.begin() + static_cast<std::ptrdiff_t>(size)}, &counts);
    EXPECT_EQ(messages.size() % 10, 0u) << "a chunk is whole or not there, at " << size;
    EXPECT_GE(messages.size(), longest) << "at " << size;
    longest = messages.size();
    ASSERT_LE(messages.size(), written.size());
    EXPECT_TRUE(std::equal(messages.begin(), messages.end(), written.begin())) << "at " << size;
    EXPECT_EQ(counts.bad_chunks + counts.bad_records, 0u);
  }
  EXPECT_EQ(longest, 40u);
}

TEST_F(Mcap, AnyDamagedByteCostsAtMostItsChunk) {
  const auto written = write(40, 10, 20);
  const Bytes whole = bytes();
  for (std::size_t at = 0; at < whole.size(); ++at) {
    Bytes damaged = whole;
    damaged[at] ^= 0x55;
    // Whatever is read is what was written: a message is never changed, only lost.
    for (const Message& message : read(damaged))
      EXPECT_TRUE(message.sequence < 40 && message == written[message.sequence]) << "byte " << at;
  }
}

TEST_F(Mcap, ADamagedChunkDoesNotHideTheNext) {
  write(40, 10, 20);
  Bytes damaged = bytes();
  const std::string compression = "lz4";
  const auto first = std::search(damaged.begin(), damaged.end(), compression.begin(), compression.end());
  ASSERT_NE(first, damaged.end());
  *(first + 40) ^= 0xFF;
  McapReader::Counts counts;
  EXPECT_EQ(read(damaged, &counts).size(), 30u);
  EXPECT_EQ(counts.bad_chunks, 1u);
  EXPECT_TRUE(counts.complete);
}

TEST_F(Mcap, ACrashLeavesWhatWasFlushed) {
  std::vector<Message> messages;
  McapWriter writer(path(), "test");
  writer.add_channel("/a", 0, "raw", {});
  for (std::uint32_t i = 0; i < 30; ++i) {
    writer.write({1, i, i, i, Bytes{1}});
    if (i == 19) writer.flush();
  }
  McapReader::Counts counts;
  EXPECT_EQ(read(bytes(), &counts).size(), 20u) << "as it lies on the disk now";
  EXPECT_FALSE(counts.complete);
  EXPECT_EQ(writer.unflushed_messages(), 10u);
}

// A limit on file size stands for the full disk: the same refusal in the middle of a write.
TEST_F(Mcap, AFullDiskLeavesWholeChunksAndWords) {
  const auto before = std::signal(SIGXFSZ, SIG_IGN);
  rlimit old{};
  getrlimit(RLIMIT_FSIZE, &old);
  const rlimit small = {100'000, old.rlim_max};
  setrlimit(RLIMIT_FSIZE, &small);
  std::mt19937 random(1);
  std::uint32_t count = 0;
  McapWriter writer(path(), "test");
  writer.add_channel("/a", 0, "raw", {});
  for (bool good = true; good && count < 1000; ++count) {
    Bytes data(1000);
    for (auto& byte : data) byte = static_cast<std::uint8_t>(random());
    good = writer.write({1, count, count, count, data}) && (count % 10 != 9 || writer.flush());
  }
  setrlimit(RLIMIT_FSIZE, &old);
  std::signal(SIGXFSZ, before);
  EXPECT_NE(writer.error().find("make room"), std::string::npos) << writer.error();
  EXPECT_FALSE(writer.flush()) << "once refused, nothing more is written";
  EXPECT_FALSE(writer.close());
  EXPECT_EQ(writer.unflushed_messages(), 10u);
  McapReader::Counts counts;
  EXPECT_EQ(read(bytes(), &counts).size(), count - 10);
  EXPECT_EQ(counts.bad_records + counts.bad_chunks, 0u);
}

TEST_F(Mcap, NeverOverwrites) {
  write(1, 1);
  EXPECT_THROW(McapWriter(path(), "test"), SetupError);
  EXPECT_THROW(McapWriter(folder_ + "/no/such/folder.mcap", "test"), SetupError);
}

TEST_F(Mcap, ForeignBytesAreNoMcap) {
  EXPECT_FALSE(McapReader(Bytes{}).is_mcap());
  EXPECT_FALSE(McapReader(Bytes(100, 0)).is_mcap());
  EXPECT_TRUE(read(Bytes(100, 0)).empty());
}

TEST_F(Mcap, SummaryIsWhereTheFooterSaysAndItsCrcFits) {
  write(40, 10);
  const Bytes file = bytes();
  const std::uint8_t* const footer = file.data() + file.size() - 8 - 20;
  const auto start = load_le<std::uint64_t>(footer);
  ASSERT_LT(start, file.size());
  EXPECT_EQ(file[start], 0x03) << "schemas first";
  EXPECT_EQ(file[load_le<std::uint64_t>(footer + 8)], 0x0E) << "offsets of the summary's groups";
  const std::size_t covered = static_cast<std::size_t>(footer + 16 - file.data()) - start;
  EXPECT_EQ(crc32({file.data() + start, covered}), load_le<std::uint32_t>(footer + 16));
  // DataEnd lies right before: opcode, length, CRC of all data before it.
  const std::size_t data_end = start - 13;
  EXPECT_EQ(file[data_end], 0x0F);
  EXPECT_EQ(crc32({file.data(), data_end}), load_le<std::uint32_t>(file.data() + data_end + 9));
}

}  // namespace
}  // namespace csipose
