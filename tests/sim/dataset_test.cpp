#include "sim/dataset.h"

#include <gtest/gtest.h>

#include <fstream>
#include <set>

#include "proto/npy.h"
#include "proto/result.h"
#include "sim/frame_maker.h"
#include "sim/object_clip.h"
#include "tests/file_bytes.h"

namespace csipose::sim {
namespace {
namespace fs = std::filesystem;
using csipose::testing::file_bytes;
constexpr std::uint32_t kClips = 3, kFrames = 2;
constexpr std::uint64_t kSeed = 4;

class DatasetTest : public ::testing::Test {
 protected:
  void SetUp() override {
    std::string pattern = (fs::temp_directory_path() / "csipose-dataset-XXXXXX").string();
    ASSERT_NE(mkdtemp(pattern.data()), nullptr);
    folder_ = pattern;
  }
  void TearDown() override { fs::remove_all(folder_); }

  DatasetPlan plan(const char* name, std::string seed = "4") {
    return {folder_ / name,
            std::vector<std::uint32_t>(kClips, kFrames),
            frame_arrays({}),
            {},
            {},
            {{"seed", std::move(seed)}}};
  }
  static ClipRows clip(std::uint32_t number) {
    const auto scene = object_scene(kSeed, number, 300);
    return make_clip(*scene, {}, impairments(ImpairmentLevel::intel5300), kSeed, number, kFrames, 300);
  }
  void make_whole(const char* name, unsigned threads) {
    Dataset dataset(plan(name));
    fill(dataset, threads, clip, [](std::uint32_t, std::uint32_t) {});
    dataset.finish();
  }
  void expect_same(const char* a, const char* b) {
    for (const ArrayPlan& array : frame_arrays({}))
      EXPECT_EQ(file_bytes(folder_ / a / (array.name + ".npy")),
                file_bytes(folder_ / b / (array.name + ".npy")))
          << array.name;
    EXPECT_EQ(file_bytes(folder_ / a / "dataset.json"), file_bytes(folder_ / b / "dataset.json"));
  }
  fs::path folder_;
};

TEST_F(DatasetTest, IsTheSameForAnyNumberOfThreads) {
  make_whole("one", 1);
  make_whole("two", 2);
  expect_same("one", "two");
}

TEST_F(DatasetTest, AClipMadeAloneIsTheSame) {
  make_whole("all", 1);
  const auto csi = read_npy<std::int8_t>(folder_ / "all" / "csi.npy");
  ASSERT_EQ(csi.shape, (NpyShape{kClips * kFrames, 20, 3, 30, 3, 2}));
  const ClipRows alone = clip(2);
  const std::size_t clip_bytes = alone[1].size();
  EXPECT_TRUE(std::equal(alone[1].begin(), alone[1].end(),
                         reinterpret_cast<const std::uint8_t*>(csi.data.data()) + 2 * clip_bytes));
  EXPECT_EQ(read_npy<std::uint32_t>(folder_ / "all" / "clip.npy").data,
            (std::vector<std::uint32_t>{0, 0, 1, 1, 2, 2}));
}

TEST_F(DatasetTest, IsNoDataSetUntilItIsWholeAndGoesOnWhereItStopped) {
  make_whole("whole", 1);
  {
    Dataset begun(plan("stopped"));
    begun.write(1, clip(1));
  }
  EXPECT_FALSE(fs::exists(folder_ / "stopped" / "dataset.json"));
  {
    Dataset resumed(plan("stopped"));
    EXPECT_TRUE(resumed.has(1));
    std::set<std::uint32_t> made;
    fill(
        resumed, 1,
        [&](std::uint32_t c) {
          made.insert(c);
          return clip(c);
        },
        [](std::uint32_t, std::uint32_t) {});
    EXPECT_EQ(made, (std::set<std::uint32_t>{0, 2}));
    resumed.finish();
  }
  expect_same("whole", "stopped");
  EXPECT_FALSE(fs::exists(folder_ / "stopped" / "progress.bin"));
  EXPECT_TRUE(Dataset(plan("stopped")).finished());
}

TEST_F(DatasetTest, AnotherPlanIsNotMixedIn) {
  { Dataset begun(plan("a")); }
  EXPECT_THROW(Dataset{plan("a", "5")}, SetupError);
  make_whole("b", 1);
  try {
    Dataset{plan("b", "5")};
    FAIL() << "another seed";
  } catch (const SetupError& error) {
    EXPECT_NE(std::string(error.what()).find("whose seed is 4 and not 5"), std::string::npos) << error.what();
  }
}

TEST_F(DatasetTest, AFailingClipEndsTheRunWithItsError) {
  Dataset dataset(plan("fails"));
  const auto failing = [](std::uint32_t c) -> ClipRows {
    if (c == 1) throw SetupError(ExitStatus::io, "no space");
    return clip(c);
  };
  EXPECT_THROW(fill(dataset, 2, failing, [](std::uint32_t, std::uint32_t) {}), SetupError);
  EXPECT_FALSE(fs::exists(folder_ / "fails" / "dataset.json"));
}

TEST(FrameMaker, LostPacketsAreMarkedAndTheRestIsWhatTheCardSaw) {
  const ClipRows rows =
      make_clip(*object_scene(1, 0, 300), {}, impairments(ImpairmentLevel::intel5300), 1, 0, 5, 300);
  const std::size_t matrix = kSubcarriers * kAntennas * 2;
  std::size_t heard = 0;
  for (std::size_t i = 0; i < rows[2].size(); ++i) {
    const auto from = rows[1].begin() + static_cast<std::ptrdiff_t>(i * matrix);
    const bool any =
        std::any_of(from, from + static_cast<std::ptrdiff_t>(matrix), [](std::uint8_t x) { return x != 0; });
    EXPECT_EQ(any, rows[2][i] == 1);
    heard += rows[2][i];
  }
  EXPECT_GT(heard, rows[2].size() * 9 / 10);
}

TEST(FrameMaker, FewSnapshotsAreTheFirstOfAFrame) {
  const auto clip = [](std::size_t snapshots) {
    const FrameFormat format{Storage::channel, snapshots};
    const std::vector<std::uint8_t> h =
        make_clip(*object_scene(1, 0, 300), format, impairments(ImpairmentLevel::none), 1, 0, 1, 300)[1];
    EXPECT_EQ(h.size(), frame_arrays(format)[1].row_bytes());
    std::vector<std::complex<float>> numbers(h.size() / sizeof(std::complex<float>));
    std::memcpy(numbers.data(), h.data(), h.size());
    return numbers;
  };
  const auto whole = clip(kSamples), one = clip(1);
  ASSERT_EQ(one.size() * kSamples, whole.size());
  double power = 0, error = 0;
  for (std::size_t i = 0; i < one.size(); ++i) {
    power += std::norm(std::complex<double>(whole[i]));
    error += std::norm(std::complex<double>(one[i] - whole[i]));
  }
  EXPECT_LT(std::sqrt(error / power),
            0.01);  // what the fast solver may be off; shadows are asked for elsewhere
}

TEST(FrameMaker, ChannelIsTheSolvers) {
  const ClipRows rows = make_clip(*object_scene(1, 0, 300), {Storage::channel},
                                  impairments(ImpairmentLevel::none), 1, 0, 1, 300);
  std::vector<std::complex<float>> stored(rows[1].size() / sizeof(std::complex<float>));
  std::memcpy(stored.data(), rows[1].data(), rows[1].size());
  ObjectClip objects = sample_object_clip(1, 0);
  const Scene scene = random_room(objects.room_m, objects.walls, objects.devices);
  std::vector<std::vector<Body>> bodies(kSamples);
  for (auto& snapshot : bodies) {
    for (const FlyingObject& object : objects.objects)
      snapshot.push_back(object.body({object.material->permittivity(scene.carrier_hz), 0}));
    objects.step(1 / 300.0);
  }
  std::vector<std::complex<float>> h(stored.size());
  FastSolver(scene).solve(bodies, h);
  EXPECT_EQ(stored, h);
}

}  // namespace
}  // namespace csipose::sim
