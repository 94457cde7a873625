// A simulated set to a folder of windows: every number in its place, losses filled as in a stream, splits kept.
#include "train/simulated_set.h"

#include <unistd.h>

#include <cmath>

#include "capture/sanitise.h"
#include "proto/npy.h"
#include "train/convert.h"
#include "train/split.h"
#include "train/window_folder.h"

namespace csipose::train {
namespace {

namespace fs = std::filesystem;
constexpr std::size_t kRows = 6;  // clips 0 0 0 1 1 2
constexpr std::size_t kStream = kSubcarriers * kAntennas * 2;
const std::vector<std::uint32_t> kClips = {0, 0, 0, 1, 1, 2};

class SimulatedSet : public ::testing::Test {
 protected:
  void SetUp() override {
    std::mt19937 random(7);
    for (std::int8_t& number : csi_) number = static_cast<std::int8_t>(random() % 255);
    for (std::size_t i = 0; i < labels_.size(); ++i) labels_[i] = static_cast<float>(i);
    fs::create_directories(set());
  }
  void TearDown() override { fs::remove_all(folder_); }

  fs::path set() const { return folder_ / "set"; }
  void lose(std::size_t row, std::size_t t, std::size_t receiver) {
    received_[(row * kSamples + t) * kReceivers + receiver] = 0;
  }
  void write(const std::string& digests = "") const {
    write_npy<std::int8_t>(set() / "csi.npy", {kRows, kSamples, kReceivers, kSubcarriers, kAntennas, 2},
                           csi_);
    write_npy<std::uint8_t>(set() / "received.npy", {kRows, kSamples, kReceivers}, received_);
    write_npy<std::uint32_t>(set() / "clip.npy", {kRows}, kClips);
    write_npy<float>(set() / "labels.npy", {kRows, 3, kJoints, 3}, labels_);
    std::ofstream(set() / "dataset.json")
        << R"({"plan": {"made_by": {"rate_hz": "300"}, "splits": {"train": [[0, 0], [2, 2]], "val": []}})"
        << digests << "}";
  }
  Converted converted(const std::string& split = "") const {
    return convert({set(), folder_ / "out", {.split = split, .env_map = {}}}, [](const std::string&) {});
  }
  std::string refusal(const std::string& split = "") const {
    try {
      (void)converted(split);
    } catch (const SetupError& error) {
      return error.what();
    }
    return "none";
  }
  StreamCsi csi(std::size_t row, std::size_t t, std::size_t receiver) const {
    const std::int8_t* at = &csi_[((row * kSamples + t) * kReceivers + receiver) * kStream];
    StreamCsi h;
    for (std::size_t k = 0; k < kSubcarriers; ++k)
      for (std::size_t a = 0; a < kAntennas; ++a) {
        const std::int8_t* pair = at + (k * kAntennas + a) * 2;
        h[a][k] = {static_cast<double>(pair[0]), static_cast<double>(pair[1])};
      }
    return h;
  }
  /// Receiver's column t of the window is what the snapshot tells.
  static void expect_sample(const std::vector<float>& x, std::size_t t, std::size_t receiver,
                            const StreamCsi& h) {
    const StreamPhase phase = sanitise_joint(h);
    for (std::size_t a = 0; a < kAntennas; ++a)
      for (std::size_t k = 0; k < kSubcarriers; ++k) {
        EXPECT_FLOAT_EQ(x[Window::index(k, t, 3 * receiver + a)], static_cast<float>(std::abs(h[a][k])));
        EXPECT_FLOAT_EQ(x[Window::index(kSubcarriers + k, t, 3 * receiver + a)],
                        static_cast<float>(phase[a][k]));
      }
  }
  static std::vector<float> window(const WindowSource& source, std::size_t i) {
    std::vector<float> x(kChannels * kTokens);
    source.read(i, x);
    return x;
  }

  fs::path folder_ = fs::temp_directory_path() / fmt::format("csipose-windows-{}", ::getpid());
  std::vector<std::int8_t> csi_ = std::vector<std::int8_t>(kRows * kSamples * kReceivers * kStream);
  std::vector<std::uint8_t> received_ = std::vector<std::uint8_t>(kRows * kSamples * kReceivers, 1);
  std::vector<float> labels_ = std::vector<float>(kRows * kPoseWidth * 3);
};

TEST_F(SimulatedSet, EveryNumberInItsPlace) {
  write();
  EXPECT_EQ(converted().windows, kRows);
  const auto source = open_window_folder(folder_ / "out");
  ASSERT_EQ(source->size(), kRows);
  for (const std::size_t row : {0u, 4u})
    for (std::size_t t = 0; t < kSamples; t += 19)
      for (std::size_t r = 0; r < kReceivers; ++r) expect_sample(window(*source, row), t, r, csi(row, t, r));
  EXPECT_EQ(source->clip(4), 1u);
  ASSERT_EQ(source->people(4).size(), 3u);
  EXPECT_EQ(source->people(4)[1][2].y, 4 * 126 + 42 + 7);
}

TEST_F(SimulatedSet, IsOfTheInstallationThatIsNamed) {
  write();
  const auto convert_as = [&](const std::string& installation) {
    return convert({set(), folder_ / "out", {}, installation}, [](const std::string&) {});
  };
  EXPECT_EQ(convert_as("hall, second powering up").windows, kRows);
  const auto source = open_window_folder(folder_ / "out");
  for (std::size_t i = 0; i < kRows; ++i) EXPECT_EQ(source->room(i), "hall, second powering up");
  EXPECT_THROW(convert_as("up/down"), SetupError);
  write_npy<std::uint8_t>(set() / "room.npy", {kRows}, std::vector<std::uint8_t>{0, 0, 0, 0, 0, 1});
  EXPECT_THROW(convert_as("hall"), SetupError) << "of two rooms";
}

TEST_F(SimulatedSet, ItsClipsAreKnownAgainInFoldersOfItsParts) {
  const auto clip_of_first = [&](const std::string& digests, const std::string& split) {
    write(digests);
    fs::remove_all(folder_ / "out");
    (void)converted(split);
    return open_window_folder(folder_ / "out")->clip_name(0);
  };
  const std::string digest = R"(, "sha256": {"csi.npy": "0123456789abcdef0123", "clip.npy": "no"})";
  EXPECT_EQ(clip_of_first(digest, "train"), "simulated 0123456789abcdef 0");
  EXPECT_EQ(clip_of_first(digest, ""), clip_of_first(digest, "train"));
  EXPECT_EQ(clip_of_first("", ""), "") << "of a set that does not tell";
}

TEST_F(SimulatedSet, FillsFromTheRowBeforeButNotFromAnotherClip) {
  lose(1, 0, 2), lose(1, 1, 2);                 // filled from the last snapshot of row 0
  lose(3, 0, 2);                                // nothing before it in its clip
  lose(4, 5, 0), lose(4, 6, 0), lose(4, 7, 0);  // longer than the daemon fills
  write();
  const Converted done = converted();
  EXPECT_EQ(done.windows, 4u);
  EXPECT_EQ(done.left_out.incomplete, 2u);
  const auto source = open_window_folder(folder_ / "out");
  expect_sample(window(*source, 1), 0, 2, csi(0, 19, 2));
  expect_sample(window(*source, 1), 1, 2, csi(0, 19, 2));
  expect_sample(window(*source, 1), 2, 2, csi(1, 2, 2));
  EXPECT_EQ(source->clip(3), 2u);
  EXPECT_EQ(source->people(3)[0][0].x, 5 * 126);
}

TEST_F(SimulatedSet, HalvesAndComplexNumbersAreTheSameChannel) {
  write();
  fs::remove(set() / "csi.npy");
  std::mt19937 random(5);
  constexpr std::size_t kRow = kSamples * kSubcarriers * kReceivers * kAntennas;
  std::vector<std::complex<float>> h(kRows * kRow);
  std::vector<std::uint16_t> halves;
  std::vector<float> rms(kRows);
  for (std::size_t row = 0; row < kRows; ++row) {
    rms[row] = 0.25f * static_cast<float>(row + 1);
    for (std::size_t i = 0; i < kRow; ++i) {
      // float16 1 + n / 1024 is 0x3c00 + n.
      const std::uint16_t re = random() % 1024, im = random() % 1024;
      halves.insert(halves.end(),
                    {static_cast<std::uint16_t>(0x3c00 + re), static_cast<std::uint16_t>(0xbc00 + im)});
      h[row * kRow + i] =
          rms[row] * std::complex(1 + static_cast<float>(re) / 1024, -1 - static_cast<float>(im) / 1024);
    }
  }
  write_npy<std::complex<float>>(set() / "h.npy", {kRows, kSamples, kSubcarriers, kReceivers, kAntennas}, h);
  EXPECT_EQ(converted().windows, kRows);
  fs::rename(folder_ / "out", folder_ / "complex");
  NpyFile half(set() / "h.npy", "<f2", 2, {kSamples, kSubcarriers, kReceivers, kAntennas, 2});
  half.append(ByteView(halves.data(), 2 * halves.size()));
  half.finish();
  EXPECT_NE(refusal().find("h.npy: is no array"), std::string::npos);  // h_rms.npy is not there
  write_npy<float>(set() / "h_rms.npy", {kRows}, rms);
  EXPECT_EQ(converted().windows, kRows);
  const auto one = open_window_folder(folder_ / "complex"), other = open_window_folder(folder_ / "out");
  for (std::size_t row = 0; row < kRows; ++row) EXPECT_EQ(window(*one, row), window(*other, row));
}

TEST_F(SimulatedSet, FewSnapshotsOfASceneAreEachHeldForTheirPartOfAWindow) {
  constexpr std::size_t kFew = 3;
  write();
  std::vector<std::int8_t> few;
  for (std::size_t row = 0; row < kRows; ++row) {
    const auto from = csi_.begin() + static_cast<std::ptrdiff_t>(row * kSamples * kReceivers * kStream);
    few.insert(few.end(), from, from + static_cast<std::ptrdiff_t>(kFew * kReceivers * kStream));
  }
  std::vector<std::uint8_t> received(kRows * kFew * kReceivers, 1);
  received[(1 * kFew + 1) * kReceivers + 2] = 0;  // of row 1, snapshot 1 by receiver 2
  write_npy<std::int8_t>(set() / "csi.npy", {kRows, kFew, kReceivers, kSubcarriers, kAntennas, 2}, few);
  EXPECT_NE(refusal().find("has not as many rows and snapshots"), std::string::npos);
  write_npy<std::uint8_t>(set() / "received.npy", {kRows, kFew, kReceivers}, received);
  EXPECT_EQ(converted().windows, kRows);
  EXPECT_EQ(read_npy<float>(folder_ / "out" / "windows.npy").shape,
            (NpyShape{kRows, kChannels, kFew, kLinks}));
  const auto source = open_window_folder(folder_ / "out");
  EXPECT_EQ(source->samples(), kFew);
  for (const std::size_t row : {0u, 4u})
    for (const auto& [t, snapshot] : {std::pair{0u, 0u}, {6u, 0u}, {7u, 1u}, {13u, 1u}, {14u, 2u}, {19u, 2u}})
      for (std::size_t r = 0; r < kReceivers; ++r)
        expect_sample(window(*source, row), t, r, csi(row, snapshot, r));
  expect_sample(window(*source, 1), 7, 2, csi(1, 0, 2));  // filled
  expect_sample(window(*source, 1), 14, 2, csi(1, 2, 2));
  // Parts and copies keep as many.
  (void)split({folder_ / "out", folder_ / "parts", SplitBy::window, 0.5, 1, {}}, [](const std::string&) {});
  const auto part = open_window_folder(folder_ / "parts" / "drawn");
  EXPECT_EQ(part->samples(), kFew);
}

TEST_F(SimulatedSet, KeepsToASplit) {
  write();
  EXPECT_EQ(converted("train").windows, 4u);
  EXPECT_EQ(open_window_folder(folder_ / "out")->clip(3), 2u);
  EXPECT_NE(refusal().find("holds windows already"), std::string::npos);
}

TEST_F(SimulatedSet, SaysWhatIsWrongAndLeavesNoSet) {
  EXPECT_NE(refusal().find("is no data set"), std::string::npos);
  write();
  EXPECT_NE(refusal("tset").find("has no split \"tset\""), std::string::npos);
  EXPECT_NE(refusal("val").find("no complete window in split val"), std::string::npos);
  fs::resize_file(set() / "csi.npy", fs::file_size(set() / "csi.npy") - 1);
  EXPECT_NE(refusal().find("csi.npy"), std::string::npos);
  EXPECT_FALSE(fs::exists(folder_ / "out" / "windows.npy"));
}

}  // namespace
}  // namespace csipose::train
