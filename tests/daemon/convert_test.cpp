#include "daemon/convert.h"

#include <gtest/gtest.h>

#include <fstream>

#include "daemon/inspect.h"
#include "proto/frame_record.h"
#include "proto/npy.h"
#include "tests/daemon/scratch_folder.h"
#include "tests/records.h"
#include "tests/shared_data.h"

namespace csipose {
namespace {

namespace fs = std::filesystem;
using Bytes = std::vector<std::uint8_t>;

class Convert : public ::testing::Test {
 protected:
  fs::path folder(const std::string& name = "out") const { return (scratch_ / name); }
  std::string write_log(const std::string& name, const Bytes& bytes) const {
    const std::string path = (scratch_ / name);
    std::ofstream(path, std::ios::binary)
        .write(reinterpret_cast<const char*>(bytes.data()), static_cast<std::streamsize>(bytes.size()));
    return path;
  }
  testing::ScratchFolder scratch_;
};

/// `count` frames of our injector at 300 a second, each with its CSI.
Bytes injected_log(int count, unsigned seed) {
  std::mt19937 random(seed);
  Bytes bytes;
  for (int i = 0; i < count; ++i) {
    const auto frame = encode_csip_record({.session = 1, .counter = 500 + static_cast<std::uint64_t>(i)});
    bytes.insert(bytes.end(), frame.begin(), frame.end());
    CsiRecord record = testing::random_record(random);
    record.timestamp_low = static_cast<std::uint32_t>(i * 1000000LL / 300);
    record.bfee_count = static_cast<std::uint16_t>(i);
    append_bfee_record(record, bytes);
  }
  return bytes;
}

TEST_F(Convert, GivesTheGoldenArraysByteForByte) {
  CSIPOSE_NEEDS_SHARED_DATA();
  for (const char* file : {"sample_0x1_ap", "sample_0x5_64_3000", "log.all_csi.6.7.6"}) {
    convert_to_npy(testing::shared_data("csi5300/" + std::string(file) + ".dat"), folder(file), {});
    for (const char* array : {"fields.npy", "csi_raw.npy"})
      EXPECT_EQ(testing::read_bytes(folder(file) / array),
                testing::read_bytes(testing::shared_data("csi5300/expected/" + std::string(file)) / array))
          << file << ' ' << array;
    for (const char* array : {"csi_scaled.npy", "csi_scaled_sm.npy"}) {
      const fs::path golden = fs::path(CSIPOSE_SHARED_DATA) / "csi5300/expected" / file / array;
      ASSERT_EQ(fs::exists(folder(file) / array), fs::exists(golden));
      if (!fs::exists(golden)) continue;
      const auto ours = read_npy<std::complex<float>>(folder(file) / array),
                 theirs = read_npy<std::complex<float>>(golden);
      ASSERT_EQ(ours.shape, theirs.shape);
      for (std::size_t i = 0; i < ours.data.size(); ++i)
        ASSERT_LE(std::abs(ours.data[i] - theirs.data[i]), 1e-6f * std::abs(theirs.data[i]) + 1e-6f);
    }
  }
}

TEST_F(Convert, GivesTheGoldenPhasesUnderTheirMask) {
  CSIPOSE_NEEDS_SHARED_DATA();
  const auto golden =
      read_npy<double>(testing::shared_data("csi5300/phase/sample_0x1_ap_first100_tx0_piw3d_angle.npy"));
  const auto golden_mask =
      read_npy<std::uint8_t>(testing::shared_data("csi5300/phase/sample_0x1_ap_first100_tx0_mask.npy"));
  convert_to_npy(testing::shared_data("csi5300/sample_0x1_ap.dat"), folder(), {.phase = PhaseMethod::joint});
  const auto phase = read_npy<double>(folder() / "phase_joint.npy");
  const auto mask = read_npy<std::uint8_t>(folder() / "phase_mask.npy");
  EXPECT_EQ(phase.shape, (NpyShape{540, 3, 30}));
  for (std::size_t i = 0; i < golden.data.size(); ++i) {
    ASSERT_EQ(mask.data[i], golden_mask.data[i]);
    if (mask.data[i] == 0) continue;
    ASSERT_NEAR(wrap_phase(phase.data[i] - golden.data[i]), 0, 1e-9);
  }
}

TEST_F(Convert, MarksWhatCannotBeScaledAndWhatHasNoPhase) {
  std::mt19937 random(2);
  CsiRecord no_rssi = testing::random_record(random), two_chains = testing::random_record(random, 2);
  no_rssi.rssi.fill(0);
  Bytes bytes = testing::encoded(no_rssi);
  append_bfee_record(two_chains, bytes);
  convert_to_npy(write_log("a.dat", bytes), folder(), {.phase = PhaseMethod::joint});
  const auto scaled = read_npy<std::complex<float>>(folder() / "csi_scaled.npy");
  const auto mask = read_npy<std::uint8_t>(folder() / "phase_mask.npy");
  EXPECT_TRUE(std::isnan(scaled.data[0].real()));
  EXPECT_FALSE(std::isnan(scaled.data[90].real()));
  EXPECT_TRUE(std::all_of(mask.data.begin() + 90, mask.data.end(), [](auto m) { return m == 0; }));
}

TEST_F(Convert, WritesWindowsOfThreeReceivers) {
  std::vector<std::string> files;
  for (unsigned rx = 0; rx < 3; ++rx)
    files.push_back(write_log("rx" + std::to_string(rx) + ".dat", injected_log(200, rx)));
  const std::size_t windows = convert_to_tensor(files, folder(), {});
  EXPECT_EQ(windows, 19u);  // 200 slots, the first window after 20, then one each 10
  const auto x = read_npy<float>(folder() / "tensor.npy");
  const auto links = read_npy<std::uint8_t>(folder() / "tensor_links.npy");
  const auto samples = read_npy<std::uint8_t>(folder() / "tensor_samples.npy");
  const auto time_ns = read_npy<std::int64_t>(folder() / "tensor_time_ns.npy");
  EXPECT_EQ(x.shape, (NpyShape{windows, kChannels, kSamples, kLinks}));
  EXPECT_TRUE(std::all_of(links.data.begin(), links.data.end(), [](auto l) { return l == 1; }));
  EXPECT_TRUE(std::all_of(samples.data.begin(), samples.data.end(), [](auto s) { return s == 2; }));
  EXPECT_NEAR(static_cast<double>(time_ns.data[1] - time_ns.data[0]), 19e9 / 300, 1e6);
  // The oldest sample of the first window is the first record.
  const auto records = testing::read_csi(files[1]);
  EXPECT_NEAR(x.data[Window::index(5, 0, 4)], std::abs(records[0].at(5, 1, 0)), 1e-4);
}

TEST_F(Convert, MasksReceiversThatWereNotGiven) {
  convert_to_tensor({write_log("rx0.dat", injected_log(100, 1))}, folder(), {});
  const auto links = read_npy<std::uint8_t>(folder() / "tensor_links.npy");
  for (std::size_t i = 0; i < links.data.size(); ++i) EXPECT_EQ(links.data[i], i % kLinks < 3 ? 1 : 0);
}

TEST_F(Convert, KeepsEveryRecordInARecording) {
  const std::string log = write_log("a.dat", injected_log(150, 3)), recording = (scratch_ / "a.mcap");
  EXPECT_EQ(convert_to_recording({log}, recording, 0), 150u);
  const Inspection before = inspect(log, RecordStream::Policy::strict),
                   after = inspect(recording, RecordStream::Policy::strict);
  ASSERT_TRUE(after.is_recording);
  EXPECT_EQ(after.records(), 150u);
  EXPECT_EQ(after.counts().codes, before.counts().codes);
  EXPECT_EQ(after.receivers[0].frames.last, 649u);
  EXPECT_TRUE(after.receivers[0].anomalies == before.receivers[0].anomalies);
  EXPECT_THROW(convert_to_recording({log}, recording, 0), SetupError);
  convert_to_npy(recording, folder(), {});
  EXPECT_EQ(read_npy<std::int64_t>(folder() / "rx1" / "fields.npy").shape[0], 150u);
}

TEST_F(Convert, RefusesInWordsAndLeavesNothingBehind) {
  const std::string text = write_log("text.dat", Bytes(300, 'x'));
  EXPECT_THROW(convert_to_npy(text, folder(), {}), SetupError);
  EXPECT_FALSE(fs::exists(folder() / "fields.npy"));
  const std::string few = write_log("few.dat", injected_log(10, 1));
  EXPECT_THROW(convert_to_tensor({few}, folder("few"), {}), SetupError);
  EXPECT_TRUE(fs::is_empty(folder("few")));
  EXPECT_THROW(convert_to_recording({text}, (scratch_ / "text.mcap"), 0), SetupError);
  EXPECT_FALSE(fs::exists((scratch_ / "text.mcap")));
}

}  // namespace
}  // namespace csipose
