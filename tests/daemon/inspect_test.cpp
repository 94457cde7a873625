#include "daemon/inspect.h"

#include <gtest/gtest.h>

#include <fstream>
#include <nlohmann/json.hpp>

#include "daemon/inspect_words.h"
#include "proto/frame_record.h"
#include "tests/daemon/scratch_folder.h"
#include "tests/records.h"
#include "tests/shared_data.h"

namespace csipose {
namespace {

using Json = nlohmann::json;
using Policy = RecordStream::Policy;
using Bytes = std::vector<std::uint8_t>;

class Inspect : public ::testing::Test {
 protected:
  ReceiverReport inspect_bytes(const Bytes& bytes, Policy policy = Policy::resynchronising) const {
    const std::string path = (scratch_ / "log.dat");
    std::ofstream(path, std::ios::binary)
        .write(reinterpret_cast<const char*>(bytes.data()), static_cast<std::streamsize>(bytes.size()));
    return inspect(path, policy).receivers.at(0);
  }
  testing::ScratchFolder scratch_;
};

bool says(const ReceiverReport& report, const std::string& words) {
  for (const std::string& sentence : report.anomalies)
    if (sentence.find(words) != std::string::npos) return true;
  return false;
}

/// A log of records 1 ms apart without any oddity; `change(i, record)` may add some.
template <class Change>
Bytes log_of(int count, Change change) {
  std::mt19937 random(1);
  Bytes bytes;
  for (int i = 0; i < count; ++i) {
    CsiRecord record = testing::random_record(random);
    record.timestamp_low = static_cast<std::uint32_t>(1000000 + 1000 * i);
    record.bfee_count = static_cast<std::uint16_t>(100 + i);
    for (auto& value : record.csi)
      value = static_cast<std::int8_t>(value == 0 ? 0 : std::clamp<int>(value / 2, -60, 60) | 1);
    if (change(i, record)) append_bfee_record(record, bytes);
  }
  return bytes;
}
constexpr auto kUnchanged = [](int, CsiRecord&) { return true; };

TEST_F(Inspect, FindsNothingOddInAGoodLog) {
  const ReceiverReport report = inspect_bytes(log_of(100, kUnchanged));
  EXPECT_EQ(report.records, 100u);
  EXPECT_EQ(report.usable, 100u);
  EXPECT_NEAR(report.clock.median_step_s, 1e-3, 1e-12);
  EXPECT_NEAR(report.clock.duration_s, 99e-3, 1e-9);
  EXPECT_TRUE(report.anomalies.empty()) << report.anomalies.front();
}

TEST_F(Inspect, SeesTheNicsClockJumpAndStandStill) {
  const auto back = inspect_bytes(log_of(60, [](int i, CsiRecord& r) {
    if (i >= 30) r.timestamp_low -= 500000;
    return true;
  }));
  EXPECT_EQ(back.clock.steps_back.size(), 1u);
  EXPECT_TRUE(says(back, "set back by 0.499000 s before CSI record 30"));
  const auto still = inspect_bytes(log_of(60, [](int, CsiRecord& r) { return r.timestamp_low = 4, true; }));
  EXPECT_TRUE(still.clock.stands_still);
  EXPECT_TRUE(says(still, "stands still"));
}

TEST_F(Inspect, TakesWrapsForWhatTheyAre) {
  const auto report = inspect_bytes(log_of(60, [](int i, CsiRecord& r) {
    r.timestamp_low = 4294967295u - 20000 + 1000u * static_cast<unsigned>(i);
    r.bfee_count = static_cast<std::uint16_t>(65520 + i);
    return true;
  }));
  EXPECT_EQ(report.clock.wraps, 1u);
  EXPECT_EQ(report.driver.wraps, 1u);
  EXPECT_TRUE(report.anomalies.empty());
}

TEST_F(Inspect, CountsWhatTheDriverMadeAndTheFileHasNot) {
  const auto report = inspect_bytes(log_of(60, [](int i, CsiRecord& r) {
    if (i == 50) r.bfee_count = static_cast<std::uint16_t>(r.bfee_count - 1);
    return i != 10 && i != 20 && i != 21 && i != 22;
  }));
  EXPECT_EQ(report.driver.lost, 1u + 3 + 1);  // the record after the repeated one is two ahead of it
  EXPECT_EQ(report.driver.repeated, 1u);
  EXPECT_EQ(report.clock.gaps.size(), 1u);
  EXPECT_TRUE(says(report, "5 records lost between driver and file, in 3 places"));
  EXPECT_TRUE(says(report, "1 gap in time, the longest 4.0 ms before CSI record 19"));
}

TEST_F(Inspect, NamesAWeakAntenna) {
  const auto report = inspect_bytes(log_of(60, [](int, CsiRecord& r) {
    for (std::size_t k = 0; k < 10; ++k)
      r.csi[CsiRecord::index(k, 1, 0)] = r.csi[CsiRecord::index(k, 1, 0) + 1] = 0;
    return true;
  }));
  EXPECT_TRUE(says(report, "antenna B: 33 % of its entries are 0"));
  EXPECT_FALSE(says(report, "antenna A"));
}

TEST_F(Inspect, ReadsTransmitCountersAndCountsDamagedFrames) {
  Bytes bytes;
  const Bytes csi = log_of(1, kUnchanged);
  for (std::uint64_t i = 0; i < 20; ++i) {
    if (i == 7) continue;
    auto frame = encode_csip_record({.session = 1, .counter = 1000 + i});
    if (i == 3) frame[40] ^= 1;
    bytes.insert(bytes.end(), frame.begin(), frame.end());
    bytes.insert(bytes.end(), csi.begin(), csi.end());
  }
  const auto report = inspect_bytes(bytes);
  EXPECT_EQ(report.frames.method, CounterMethod::csip);
  EXPECT_EQ(report.frames.first, 1000u);
  EXPECT_EQ(report.frames.last, 1019u);
  EXPECT_EQ(report.frames.missing, 2u);
  EXPECT_EQ(report.frames.bad_fcs, 1u);
  EXPECT_TRUE(says(report, "1 frame with a wrong check sum"));
}

TEST_F(Inspect, SaysWhereFramingFailed) {
  Bytes bytes = log_of(5, kUnchanged);
  bytes.insert(bytes.begin() + 430, {0, 0});
  EXPECT_TRUE(says(inspect_bytes(bytes), "byte 430: a record of length 0 (zero_length)"));
  EXPECT_EQ(inspect_bytes(bytes).records, 5u);
  EXPECT_EQ(inspect_bytes(bytes, Policy::strict).records, 2u);
}

TEST_F(Inspect, SaysWhatIsNoCsitoolLog) {
  const std::string path = (scratch_ / "text.dat");
  std::ofstream(path) << "This is a text file, and not a log of anything at all. It goes on for a while.";
  EXPECT_NE(to_text(inspect(path, Policy::resynchronising)).find("not a csitool log"), std::string::npos);
  EXPECT_THROW(inspect((scratch_ / "absent.dat"), Policy::strict), SetupError);
}

TEST_F(Inspect, GivesTheManifestsCountsInJson) {
  CSIPOSE_NEEDS_SHARED_DATA();
  const auto folder = testing::shared_data("csi5300/malformed");
  const Json manifest = Json::parse(testing::read_bytes(folder / "manifest.json"));
  for (const auto& [file, expected] : manifest["files"].items())
    for (const char* policy : {"strict", "resync"}) {
      const bool strict = std::string(policy) == "strict";
      const Json answer = Json::parse(to_json(
          inspect((folder / (file + ".dat")).string(), strict ? Policy::strict : Policy::resynchronising)));
      for (const char* key : {"records", "usable", "errors", "other_codes"})
        EXPECT_EQ(answer[key], expected[policy][key]) << file << ' ' << policy << ' ' << key;
    }
}

TEST_F(Inspect, AgreesWithTheFactsOfTheRecordings) {
  CSIPOSE_NEEDS_SHARED_DATA();
  const Json facts = Json::parse(testing::read_bytes(testing::shared_data("csi5300/facts.json")));
  for (const Json& file : facts["files"]) {
    const auto path = testing::shared_data("csi5300/" + file["file"].get<std::string>()).string();
    const ReceiverReport report = inspect(path, Policy::strict).receivers.at(0);
    EXPECT_EQ(report.records, file["stored_records"]);
    EXPECT_EQ(Json(report.sizes), file["nrx_ntx"]);
    EXPECT_EQ(report.zero_entries[0] + report.zero_entries[1] + report.zero_entries[2],
              file["zero_csi_entries"]);
    EXPECT_NEAR(report.rss_dbm.sum, file["total_rss_sum"], 1e-6);
    EXPECT_NEAR(report.clock.median_step_s * 1e6, file["timestamp"]["median_delta_us"], 0.51);
    EXPECT_EQ(report.clock.steps_back.size(), file["timestamp"]["backward_steps"].size());
    if (!file.contains("mpdu")) continue;
    EXPECT_EQ(report.frames.missing, file["mpdu"]["tx_index"]["missing"].size());
  }
}

}  // namespace
}  // namespace csipose
