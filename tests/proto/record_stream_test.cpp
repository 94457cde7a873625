#include "proto/record_stream.h"

#include <gtest/gtest.h>

#include <map>
#include <nlohmann/json.hpp>
#include <string>
#include <vector>

#include "tests/records.h"
#include "tests/shared_data.h"

namespace csipose {
namespace {

using Policy = RecordStream::Policy;
using Input = RecordStream::Input;
using Json = nlohmann::json;
using Bytes = std::vector<std::uint8_t>;

/// What the manifest says of a file: records, usable, errors and other codes by name.
Json summary(RecordStream& stream) {
  std::uint64_t records = 0, usable = 0;
  while (const auto raw = stream.next()) {
    if (raw->code != kCsiCode) continue;
    CsiRecord record;
    const auto refusal = decode_bfee(raw->body, record);
    count_decoded(stream.counts(), refusal, record);
    records += !refusal;
    usable += !refusal && record.usable();
  }
  Json errors = Json::object(), codes = Json::object();
  for (std::size_t i = 0; i < kRecordFaults; ++i)
    if (const auto fault = static_cast<RecordFault>(i); stream.counts()[fault] != 0)
      errors[name(fault)] = stream.counts()[fault];
  for (int code = 0; code < 256; ++code) {
    char key[8];
    std::snprintf(key, sizeof key, "0x%02x", code);
    if (code != kCsiCode && stream.counts().codes[code] != 0) codes[key] = stream.counts().codes[code];
  }
  return {{"records", records}, {"usable", usable}, {"errors", errors}, {"other_codes", codes}};
}

Bytes record_bytes(std::uint8_t code, const Bytes& body) {
  Bytes bytes(3);
  store_be16(bytes.data(), static_cast<std::uint16_t>(body.size() + 1));
  bytes[2] = code;
  bytes.insert(bytes.end(), body.begin(), body.end());
  return bytes;
}

Bytes good_record() {
  std::mt19937 random(7);
  return testing::encoded(testing::random_record(random));
}

Bytes operator+(Bytes a, const Bytes& b) {
  a.insert(a.end(), b.begin(), b.end());
  return a;
}

TEST(RecordStream, GivesTheManifestsCountsForEveryMalformedFile) {
  CSIPOSE_NEEDS_SHARED_DATA();
  const auto folder = testing::shared_data("csi5300/malformed");
  const Json manifest = Json::parse(testing::read_bytes(folder / "manifest.json"));
  ASSERT_EQ(manifest["files"].size(), 52u);
  for (const auto& [file, expected] : manifest["files"].items()) {
    const Bytes bytes = testing::read_bytes(folder / (file + ".dat"));
    ASSERT_EQ(bytes.size(), expected["bytes"]) << file;
    RecordStream strict(bytes, Policy::strict), resync(bytes, Policy::resynchronising);
    EXPECT_EQ(summary(strict), expected["strict"]) << file << ": " << expected["what"];
    EXPECT_EQ(summary(resync), expected["resync"]) << file << ": " << expected["what"];
  }
}

/// A file that arrives in pieces must end up with the counts of the whole file.
TEST(RecordStream, GivesTheSameCountsWhenTheInputGrowsByteByByte) {
  CSIPOSE_NEEDS_SHARED_DATA();
  const auto folder = testing::shared_data("csi5300/malformed");
  const Json manifest = Json::parse(testing::read_bytes(folder / "manifest.json"));
  for (const auto& [file, expected] : manifest["files"].items()) {
    const Bytes bytes = testing::read_bytes(folder / (file + ".dat"));
    for (const Policy policy : {Policy::strict, Policy::resynchronising}) {
      RecordStream stream(ByteView(), policy, Input::growing);
      std::uint64_t records = 0;
      for (std::size_t have = 1; have <= bytes.size(); ++have) {
        stream.refill(ByteView(bytes).sub(0, have), 0);
        while (stream.next()) ++records;
      }
      stream.finish();
      const Json rest = summary(stream);
      const Json& whole = expected[policy == Policy::strict ? "strict" : "resync"];
      // A damaged length past the end is waited for, which only the end settles; the counts are the same.
      for (const char* framing : {"leftover", "zero_length", "truncated", "lost_framing", "resync"})
        EXPECT_EQ(rest["errors"].value(framing, 0), whole["errors"].value(framing, 0))
            << file << ' ' << framing;
      EXPECT_EQ(rest["other_codes"], whole["other_codes"]) << file;
    }
  }
}

TEST(RecordStream, TellsWhereEachRecordBegins) {
  const Bytes bytes = record_bytes(kFrameCode, {1, 2, 3}) + good_record() + record_bytes(0xD0, {});
  RecordStream stream(bytes, Policy::strict);
  const auto frame = stream.next(), csi = stream.next(), noise = stream.next();
  ASSERT_TRUE(frame && csi && noise);
  EXPECT_EQ(frame->offset, 0u);
  EXPECT_EQ(csi->offset, 6u);
  EXPECT_EQ(noise->offset, 6u + 215);
  EXPECT_EQ(noise->body.size(), 0u);
  EXPECT_EQ(frame->framed().size(), 6u);
  EXPECT_EQ(frame->framed().data(), bytes.data());
  EXPECT_FALSE(stream.next());
  EXPECT_FALSE(stream.fault());
}

TEST(RecordStream, SaysWhatWasWrongAndWhereItGoesOn) {
  const Bytes bytes = good_record() + Bytes{0, 0} + good_record();
  RecordStream stream(bytes, Policy::resynchronising);
  ASSERT_TRUE(stream.next());
  const auto second = stream.next();
  ASSERT_TRUE(second && stream.fault());
  EXPECT_EQ(stream.fault()->fault, RecordFault::zero_length);
  EXPECT_EQ(stream.fault()->offset, 215u);
  EXPECT_EQ(second->offset, 217u);
}

TEST(RecordStream, StrictEndsAtTheFirstFramingFault) {
  const Bytes bytes = good_record() + Bytes{0, 0} + good_record();
  RecordStream stream(bytes, Policy::strict);
  ASSERT_TRUE(stream.next());
  EXPECT_FALSE(stream.broken());
  EXPECT_FALSE(stream.next());
  EXPECT_TRUE(stream.broken());
  EXPECT_FALSE(stream.next());
  EXPECT_EQ(stream.counts()[RecordFault::zero_length], 1u);
}

TEST(RecordStream, LosesFramingWhenAnUnknownCodeLeadsNowhere) {
  const Bytes leads_nowhere = record_bytes(0x42, {9, 9}) + Bytes{0, 0, 0, 0} + good_record();
  RecordStream stream(leads_nowhere, Policy::resynchronising);
  ASSERT_TRUE(stream.next());
  EXPECT_EQ(stream.fault()->fault, RecordFault::lost_framing);
  const Bytes leads_on = record_bytes(0x42, {9, 9}) + good_record();
  RecordStream skipping(leads_on, Policy::strict);
  EXPECT_EQ(skipping.next()->code, 0x42);
  EXPECT_EQ(skipping.next()->code, kCsiCode);
}

TEST(RecordStream, WaitsForTheRestOfAGrowingInput) {
  const Bytes bytes = good_record() + good_record();
  RecordStream stream(ByteView(bytes).sub(0, 300), Policy::strict, Input::growing);
  EXPECT_TRUE(stream.next());
  EXPECT_FALSE(stream.next());
  EXPECT_FALSE(stream.broken());
  EXPECT_EQ(stream.offset(), 215u);
  stream.refill(ByteView(bytes).sub(215), 215);
  EXPECT_EQ(stream.next()->offset, 215u);
  EXPECT_EQ(stream.counts().codes[kCsiCode], 2u);
}

TEST(RecordStream, JudgesWhatIsLeftOnceAGrowingInputEnds) {
  const Bytes bytes = good_record();
  RecordStream stream(ByteView(bytes).sub(0, 100), Policy::strict, Input::growing);
  EXPECT_FALSE(stream.next());
  EXPECT_EQ(stream.counts()[RecordFault::truncated], 0u);
  stream.finish();
  EXPECT_FALSE(stream.next());
  EXPECT_EQ(stream.counts()[RecordFault::truncated], 1u);
}

Bytes several_records(int nrx, bool with_frames) {
  std::mt19937 random(12);
  Bytes bytes;
  for (int i = 0; i < 40; ++i) {
    Bytes frame(100);
    for (auto& byte : frame) byte = static_cast<std::uint8_t>(random());
    if (with_frames) bytes = bytes + record_bytes(kFrameCode, frame);
    bytes = bytes + testing::encoded(testing::random_record(random, nrx));
  }
  return bytes;
}

/// Where records begin, and the end.
std::vector<std::size_t> record_offsets(const Bytes& bytes) {
  std::vector<std::size_t> offsets;
  RecordStream stream(bytes, Policy::strict);
  while (const auto record = stream.next()) offsets.push_back(record->offset);
  offsets.push_back(bytes.size());
  return offsets;
}

std::size_t csi_records(const Bytes& bytes) {
  RecordStream stream(bytes, Policy::resynchronising);
  std::size_t decoded = 0;
  while (const auto raw = stream.next()) {
    CsiRecord record;
    decoded += raw->code == kCsiCode && !decode_bfee(raw->body, record);
  }
  return decoded;
}

/// For every length that a record could claim instead of its own, but those that lead exactly to a later
/// record.
TEST(RecordStream, LosesAtMostTwoRecordsToADamagedLength) {
  for (const int nrx : {1, 3})
    for (const bool with_frames : {false, true}) {
      const Bytes good = several_records(nrx, with_frames);
      const std::vector<std::size_t> offsets = record_offsets(good);
      for (const std::size_t damaged : {offsets[2], offsets[3]})
        for (unsigned length = 0; length < 65536; length += length < good.size() ? 1 : 97) {
          if (std::count(offsets.begin(), offsets.end(), damaged + 2 + length) != 0) continue;
          Bytes bytes = good;
          store_be16(bytes.data() + damaged, static_cast<std::uint16_t>(length));
          ASSERT_GE(csi_records(bytes), 40u - 2) << "length " << length << " at " << damaged;
        }
    }
}

/// What a damaged length had swallowed is given after all, and nothing is given twice.
TEST(RecordStream, GivesEachRecordOnce) {
  Bytes bytes = several_records(3, true);
  const std::vector<std::size_t> offsets = record_offsets(bytes);
  store_be16(bytes.data() + offsets[4], 3001);
  RecordStream stream(bytes, Policy::resynchronising);
  std::vector<std::uint64_t> seen;
  while (const auto record = stream.next())
    if (record->code == kCsiCode) seen.push_back(record->offset);
  EXPECT_TRUE(std::is_sorted(seen.begin(), seen.end()));
  EXPECT_EQ(std::adjacent_find(seen.begin(), seen.end()), seen.end());
  EXPECT_EQ(seen.size(), 40u);
}

TEST(RecordStream, NamesItsFaultsAsTheirEnumerators) {
  EXPECT_STREQ(name(RecordFault::leftover), "leftover");
  EXPECT_STREQ(name(RecordFault::payload_short), "payload_short");
  EXPECT_STREQ(name(RecordFault::resync), "resync");
  EXPECT_STREQ(name(RecordFault::all_zero_rssi), "all_zero_rssi");
}

}  // namespace
}  // namespace csipose
