#include "daemon/truth_recording.h"

#include <gtest/gtest.h>

#include <fstream>

#include "model/model.h"
#include "proto/recording.h"
#include "tests/daemon/program.h"
#include "tests/daemon/scratch_folder.h"
#include "tests/file_bytes.h"

namespace csipose {
namespace {

using namespace std::chrono_literals;

const std::string kRecord = "record";

class RecordedTruth : public ::testing::Test {
 protected:
  static UtcTime time(std::int64_t ms) { return UtcTime{1790000000s + std::chrono::milliseconds(ms)}; }

  /// Instants 10 ms apart between packets; the one at 50 ms, when it is `damaged`, is no truth.
  void write(std::uint64_t count, bool damaged = false) const {
    RecordingWriter writer(path_, RecordingInfo(), {});
    for (std::uint64_t i = 0; i < count; ++i) {
      const auto ms = static_cast<std::int64_t>(10 * i);
      const SteadyTime steady{std::chrono::milliseconds(ms)};
      ASSERT_TRUE(writer.add(Packet{0, steady, time(ms), kRecord}));
      Truth truth;
      truth.counter = i;
      truth.sent = time(ms);
      truth.people.resize(2);
      std::string line = damaged && i == 5 ? "{\"type\":\"truth\"}" : encode(truth);
      ASSERT_TRUE(writer.add(TruthItem{line, i, steady, time(ms)}));
    }
    ASSERT_TRUE(writer.close());
  }

  testing::ScratchFolder folder_;
  const std::string path_ = folder_ / "a.mcap";
};

TEST_F(RecordedTruth, IsReadAlongWithTheTimesAskedFor) {
  write(1000);
  const auto truth = TruthRecording::open(path_);
  ASSERT_NE(truth, nullptr);
  EXPECT_EQ(truth->hello(), nullptr);
  EXPECT_EQ(truth->at(time(34))->counter, 3U);
  EXPECT_EQ(truth->at(time(36))->counter, 4U);
  EXPECT_EQ(truth->at(time(36))->people.size(), 2U);
  EXPECT_EQ(truth->at(time(5000))->counter, 500U);
  EXPECT_EQ(truth->at(time(1000)), nullptr) << "that old is forgotten";
  EXPECT_EQ(truth->at(time(9990))->counter, 999U);
  EXPECT_EQ(truth->at(time(10020)), nullptr) << "further away than one packet";
}

TEST_F(RecordedTruth, IsNotInOtherFiles) {
  {
    RecordingWriter writer(path_, RecordingInfo(), {});
    ASSERT_TRUE(writer.add(Packet{0, SteadyTime{}, UtcTime{}, kRecord}));
    ASSERT_TRUE(writer.close());
  }
  EXPECT_EQ(TruthRecording::open(path_), nullptr);
  const std::string log = folder_ / "a.dat";
  std::ofstream(log) << "no recording";
  EXPECT_EQ(TruthRecording::open(log), nullptr);
  EXPECT_THROW(TruthRecording::open(folder_ / "none.mcap"), SetupError);
}

TEST_F(RecordedTruth, ThatIsDamagedIsRefused) {
  write(10, true);
  const auto truth = TruthRecording::open(path_);
  EXPECT_EQ(truth->at(time(20))->counter, 2U);
  EXPECT_THROW(truth->at(time(80)), SetupError);
}

// What the command says at its end: every frame that has a window, beside the truth of the recording.
TEST_F(RecordedTruth, IsWhatAReplayMeasuresAgainst) {
  const std::string log = folder_ / "log";
  ASSERT_EQ(
      testing::Program("csipose-sim", {"record", "--people", "1", "--seconds", "0.4", "--out", path_}, log)
          .wait(),
      0)
      << testing::file_bytes(log);
  const std::string model = folder_ / "w.safetensors";
  write_file_atomically(model, random_weights(preset_config("micro"), 1, HeadInit::random));
  const std::vector<std::string> replay = {"--set",    "model.path=" + model,
                                           "--set",    "people.min_score=0",
                                           "replay",   path_,
                                           "--speed",  "max",
                                           "--format", "text"};
  testing::Program program("csipose", replay, log);
  ASSERT_EQ(program.wait(), 0) << program.log();
  EXPECT_TRUE(program.has_said("against the truth, 11 frames")) << program.log();
}

}  // namespace
}  // namespace csipose
