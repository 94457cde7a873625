// What csipose-sim record writes, to windows with labels: the tensors of csipose convert, the people of the truth.
#include "train/recorded_set.h"

#include <cmath>

#include "daemon/convert.h"
#include "proto/npy.h"
#include "tests/daemon/program.h"
#include "tests/daemon/scratch_folder.h"
#include "train/convert.h"
#include "train/window_folder.h"

namespace csipose::train {
namespace {

namespace fs = std::filesystem;
using csipose::testing::Program;
using csipose::testing::ScratchFolder;

void record(const std::string& out, const std::vector<std::string>& scene, const std::string& log) {
  std::vector<std::string> words = {"record", "--out", out, "--seconds", "2", "--seed", "4"};
  words.insert(words.end(), scene.begin(), scene.end());
  Program program("csipose-sim", words, log);
  ASSERT_EQ(program.wait(), 0) << program.log();
}

class RecordedSet : public ::testing::Test {
 protected:
  Converted converted(const std::string& from, const std::string& to, const DataSetOptions& options = {}) {
    return convert({folder_ / from, folder_ / to, options},
                   [this](const std::string& words) { warnings_.push_back(words); });
  }
  std::string refusal(const std::string& from) {
    try {
      (void)converted(from, "refused");
    } catch (const SetupError& error) {
      return error.what();
    }
    return "none";
  }
  static double distance_m(const Skeleton& a, const Skeleton& b) {
    double most = 0;
    for (std::size_t j = 0; j < kJoints; ++j)
      most =
          std::max(most, static_cast<double>(std::hypot(a[j].x - b[j].x, a[j].y - b[j].y, a[j].z - b[j].z)));
    return most;
  }

  ScratchFolder folder_;
  std::vector<std::string> warnings_;
};

const std::vector<std::string> kOffice = {"--scene", "office", "--people", "2"};

TEST_F(RecordedSet, LogsAndRecordingGiveTheSameWindowsAndPeople) {
  record(folder_ / "logs", kOffice, folder_ / "log");
  record(folder_ / "room.mcap", kOffice, folder_ / "log");
  const Converted logs = converted("logs", "of_logs"), recording = converted("room.mcap", "of_recording");
  EXPECT_EQ(logs.kind, "recording");
  EXPECT_TRUE(logs.labelled && recording.labelled);
  EXPECT_GT(logs.windows, 15u);  // 30 of 20 packets, less those where a receiver lost too much
  EXPECT_TRUE(warnings_.empty());

  const auto one = open_window_folder(folder_ / "of_logs"),
             other = open_window_folder(folder_ / "of_recording");
  const auto truth = read_npy<float>(folder_ / "logs/truth.npy");
  ASSERT_EQ(truth.shape, (NpyShape{600, 2, kJoints, 3}));
  ASSERT_EQ(one->size(), other->size());
  std::vector<float> x(kChannels * kTokens), y(x);
  for (std::size_t i = 0; i < one->size(); ++i) {
    one->read(i, x), other->read(i, y);
    EXPECT_EQ(x, y) << i;
    ASSERT_EQ(one->people(i).size(), 2u);
    ASSERT_EQ(other->people(i).size(), 2u);
    for (std::size_t p = 0; p < 2; ++p)  // within a packet, in which nobody gets further than 3 cm
      EXPECT_LT(distance_m(one->people(i)[p], other->people(i)[p]), 0.03) << i;
  }
}

TEST_F(RecordedSet, TheWindowsAreThoseOfTheDaemonAndTheLabelsOfSnapshotTen) {
  record(folder_ / "logs", {"--scene", "office", "--people", "1", "--impair", "none"}, folder_ / "log");
  EXPECT_EQ(converted("logs", "out").windows, 30u);  // nothing is lost
  TensorOptions options;
  options.front_end.hop = 20;
  ASSERT_EQ(convert_to_tensor({folder_ / "logs/rx1.dat", folder_ / "logs/rx2.dat", folder_ / "logs/rx3.dat"},
                              folder_ / "daemon", options),
            30u);
  const auto tensor = read_npy<float>(folder_ / "daemon/tensor.npy");
  const auto truth = read_npy<float>(folder_ / "logs/truth.npy");
  const auto source = open_window_folder(folder_ / "out");
  std::vector<float> x(kChannels * kTokens);
  for (std::size_t i = 0; i < 30; ++i) {
    source->read(i, x);
    EXPECT_TRUE(std::ranges::equal(x, std::span(tensor.data).subspan(i * x.size(), x.size()))) << i;
    const float* joint = truth.data.data() + (20 * i + 10) * kPoseWidth;
    EXPECT_EQ(source->people(i)[0][0].x, joint[0]) << i;
    EXPECT_EQ(source->people(i)[0][13].z, joint[3 * 13 + 2]) << i;
  }
}

TEST_F(RecordedSet, WithoutTruthThereAreNoLabels) {
  record(folder_ / "logs", {"--scene", "reflector"}, folder_ / "log");
  const Converted done = converted("logs", "out");
  EXPECT_FALSE(done.labelled);
  ASSERT_EQ(warnings_.size(), 1u);
  EXPECT_NE(warnings_[0].find("holds no truth"), std::string::npos);
  EXPECT_FALSE(fs::exists(folder_ / "out/labels.npy"));
  fs::remove(folder_ / "logs/rx3.dat");
  EXPECT_NE(refusal("logs").find("lacks rx3.dat"), std::string::npos);
  fs::copy_file(folder_ / "logs/rx1.dat", folder_ / "bad.mcap");
  EXPECT_NE(refusal("bad.mcap"), "none");
  EXPECT_FALSE(fs::exists(folder_ / "refused/windows.npy"));
}

}  // namespace
}  // namespace csipose::train
