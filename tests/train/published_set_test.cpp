// The published layout to windows: a miniature made here, the golden one, and files that cannot be used.
#include "train/published_set.h"

#include <unistd.h>

#include <cmath>
#include <nlohmann/json.hpp>

#include "tests/shared_data.h"
#include "tests/train/made_up_published.h"
#include "train/convert.h"
#include "train/mat_file.h"
#include "train/window_folder.h"

namespace csipose::train {
namespace {

namespace fs = std::filesystem;
using csipose::testing::made_up_csi;
using csipose::testing::MatOptions;
using csipose::testing::shared_data;
using csipose::testing::write_mat;
using csipose::testing::write_published_split;

class PublishedSet : public ::testing::Test {
 protected:
  void SetUp() override { fs::create_directories(folder_); }
  void TearDown() override { fs::remove_all(folder_); }

  fs::path root() const { return folder_ / "root"; }
  fs::path out() const { return folder_ / "out"; }
  Converted converted(const DataSetOptions& options = {}) {
    return convert({root(), out(), options},
                   [this](const std::string& words) { warnings_.push_back(words); });
  }
  std::string refusal(const DataSetOptions& options = {}) {
    try {
      (void)converted(options);
    } catch (const SetupError& error) {
      EXPECT_FALSE(fs::exists(out() / "windows.npy"));
      return error.what();
    }
    return "none";
  }
  std::string mat_refusal(const fs::path& path) const {
    try {
      (void)read_mat(path);
    } catch (const SetupError& error) {
      const std::string words = error.what();
      EXPECT_EQ(words.find(path.string() + ": "), 0u) << words;
      EXPECT_EQ(words.find('\n'), std::string::npos);
      return words.substr(path.string().size() + 2);
    }
    return "none";
  }

  fs::path folder_ = fs::temp_directory_path() / fmt::format("csipose-published-{}", ::getpid());
  std::vector<std::string> warnings_;
};

/// x as the reference loader has it: amplitudes to a millionth, phases to 1e-4 rad, turns apart.
void expect_golden(std::span<const float> x, const NpyArray<float>& golden, const std::string& name) {
  ASSERT_EQ(golden.shape, (NpyShape{kChannels, kSamples, kLinks})) << name;
  constexpr std::size_t kAmplitudes = kSubcarriers * kTokens;
  double amplitude = 0, phase = 0;
  for (std::size_t i = 0; i < golden.data.size(); ++i) {
    const double is = x[i], should = golden.data[i];
    double& worst = i < kAmplitudes ? amplitude : phase;
    worst = std::max(worst, i < kAmplitudes ? std::abs(is - should) / should
                                            : std::abs(std::remainder(is - should, 2 * std::numbers::pi)));
  }
  EXPECT_LT(amplitude, 1e-6) << name;
  EXPECT_LT(phase, 1e-4) << name;
}

void expect_golden(const LabelledWindow& window, const nlohmann::json& entry, const fs::path& expected) {
  const std::string name = entry.at("name");
  expect_golden(window.x, read_npy<float>(expected / (name + ".npy")), name);
  EXPECT_EQ(window.people.size(), entry.at("persons").get<std::size_t>()) << name;
  EXPECT_EQ(scene_of_clip(window.clip), entry.at("scene").get<std::uint32_t>()) << name;
  EXPECT_EQ(window.clip % 100, entry.at("clip").get<std::uint32_t>()) << name;
  double sum = 0;
  for (std::size_t k = 0; k < kSubcarriers * kTokens; ++k) sum += static_cast<double>(window.x[k]);
  EXPECT_NEAR(sum / (kSubcarriers * kTokens), entry.at("mean_amp").get<double>(), 1e-4) << name;
}

/// The windows that the manifest has of a split, in our order.
std::vector<nlohmann::json> manifest_of(const std::string& split) {
  std::ifstream file(shared_data("model/piw3d_mini_expected/manifest.json"));
  std::vector<nlohmann::json> entries;
  for (const nlohmann::json& entry : nlohmann::json::parse(file))
    if (entry.at("split") == split) entries.push_back(entry);
  std::ranges::stable_sort(entries, {}, [](const nlohmann::json& entry) {
    return std::tuple(entry.at("scene").get<int>(), entry.at("persons").get<int>(),
                      entry.at("clip").get<int>(), entry.at("frame").get<int>());
  });
  return entries;
}

TEST_F(PublishedSet, TheGoldenMiniature) {
  CSIPOSE_NEEDS_SHARED_DATA();
  for (const std::string split : {"train", "test"}) {
    const std::vector<nlohmann::json> entries = manifest_of(split);
    const fs::path expected = shared_data("model/piw3d_mini_expected") / (split + "_data");
    const auto set = open_data_set(shared_data("model/piw3d_mini"), {.split = split, .env_map = {}});
    std::size_t i = 0;
    set->read(
        [&](const LabelledWindow& window) {
          ASSERT_LT(i, entries.size());
          expect_golden(window, entries[i++], expected);
        },
        [](const std::string& words) { ADD_FAILURE() << words; });
    EXPECT_EQ(i, split == "train" ? 8u : 4u);
    EXPECT_EQ(i, entries.size());
  }
}

TEST_F(PublishedSet, TheGoldenFilesThatAreOdd) {
  CSIPOSE_NEEDS_SHARED_DATA();
  const fs::path robust = shared_data("model/piw3d_robust");
  EXPECT_EQ(mat_refusal(robust / "missing_key.mat"), "holds no array csi_out");
  EXPECT_NE(mat_refusal(robust / "bad_shape.mat").find("csi_out has the shape (19, "), std::string::npos);
  EXPECT_NE(mat_refusal(robust / "not_compound.mat").find("is no compound of real and imag"),
            std::string::npos);
  EXPECT_NE(mat_refusal(robust / "truncated.mat").find("damaged or cut short"), std::string::npos);
  write_published_split(root(), "train", {"S11_01_10"});
  fs::copy_file(robust / "swapped_f32.mat", root() / "train_data/csi/S11_01_10.mat",
                fs::copy_options::overwrite_existing);
  open_data_set(root(), {})
      ->read(
          [&](const LabelledWindow& window) {
            expect_golden(window.x, read_npy<float>(robust / "swapped_f32_expected.npy"), "swapped_f32");
          },
          [](const std::string&) {});
}

TEST_F(PublishedSet, EveryNumberInItsPlaceWhateverTheLayout) {
  const auto csi = made_up_csi(3);
  const std::vector<MatOptions> layouts = {{},
                                           {.chunked = false},
                                           {.imag_first = true, .chunked = false},
                                           {.number = H5T_IEEE_F32BE},
                                           {.number = H5T_IEEE_F32LE, .imag_first = true}};
  for (const MatOptions& layout : layouts) {
    write_mat(folder_ / "a.mat", csi, layout);
    const std::vector<StreamCsi> read = read_mat(folder_ / "a.mat");
    ASSERT_EQ(read.size(), kSamples * kReceivers);
    for (std::size_t t = 0; t < kSamples; ++t)
      for (std::size_t r = 0; r < kReceivers; ++r)
        for (std::size_t a = 0; a < kAntennas; ++a)
          for (std::size_t k = 0; k < kSubcarriers; ++k)
            ASSERT_LT(std::abs(read[t * kReceivers + r][a][k] - csi[((t * 30 + k) * 3 + a) * 3 + r]), 1e-5);
  }
}

TEST_F(PublishedSet, MatFilesThatCannotBeUsed) {
  const fs::path path = folder_ / "a.mat";
  const auto csi = made_up_csi(3);
  EXPECT_EQ(mat_refusal(path), "No such file or directory");
  EXPECT_EQ(mat_refusal(folder_), "is no file");
  std::ofstream(path) << "MATLAB 5.0 MAT-file";
  EXPECT_EQ(mat_refusal(path), "is no MATLAB v7.3 (HDF5) file");
  write_mat(path, csi, {.dataset = "csi"});
  EXPECT_EQ(mat_refusal(path), "holds no array csi_out");
  write_mat(path, csi, {.shape = {20, 30, 9}});
  EXPECT_EQ(mat_refusal(path), "csi_out has the shape (20, 30, 9), wanted (20, 30, 3, 3)");
  write_mat(path, csi, {.compound = false});
  EXPECT_EQ(mat_refusal(path), "csi_out is no compound of real and imag in float64 or float32");
  auto broken = csi;
  broken[4321] = {1, std::nan("")};
  write_mat(path, broken);
  EXPECT_EQ(mat_refusal(path), "csi_out holds a number that is not finite");
}

// Wherever it is cut, a file is read whole or refused.
TEST_F(PublishedSet, MatFilesThatAreCut) {
  const fs::path path = folder_ / "a.mat";
  for (const bool chunked : {true, false}) {
    write_mat(path, made_up_csi(3), {.chunked = chunked});
    const auto size = fs::file_size(path);
    for (int part = 15; part >= 0; --part) {
      fs::resize_file(path, size * static_cast<unsigned>(part) / 16);
      EXPECT_NE(mat_refusal(path), "none") << part;
    }
  }
}

TEST_F(PublishedSet, ClipByClipWithLabelsAndEnvironments) {
  write_published_split(root(), "train", {"S52_40_322", "S11_27_12", "S11_27_9", "S11_03_80"});
  write_published_split(root(), "test", {"S23_12_337"});
  std::ofstream(folder_ / "map.json") << R"({"office": ["1"], "corridor": ["2", "5"], "hall": ["7"]})";
  const Converted done = converted({.split = "", .env_map = folder_ / "map.json"});
  EXPECT_EQ(done.kind, "published");
  EXPECT_TRUE(done.labelled);
  EXPECT_EQ(done.windows, 5u);
  EXPECT_TRUE(warnings_.empty()) << warnings_.front();
  EXPECT_EQ(read_npy<std::uint32_t>(out() / "clip.npy").data,
            (std::vector<std::uint32_t>{1103, 1127, 1127, 2312, 5240}));
  EXPECT_EQ(read_npy<std::uint8_t>(out() / "room.npy").data, (std::vector<std::uint8_t>{0, 0, 0, 1, 1}));
  const auto set = open_window_folder(out());
  EXPECT_EQ(set->clip_name(0), fmt::format("published {} 1103", root().filename().string()));
  EXPECT_EQ(set->people(0).size(), 1u);
  ASSERT_EQ(set->people(3).size(), 3u);
  EXPECT_EQ(set->people(3)[2][13].x, 2);
  EXPECT_EQ(set->people(3)[2][13].y, 13);
  // S11_27_9 comes before S11_27_12: its numbers are those of seed 2.
  std::vector<float> x(kChannels * kTokens);
  set->read(1, x);
  EXPECT_FLOAT_EQ(x[Window::index(4, 2, 5)],
                  static_cast<float>(std::abs(made_up_csi(2)[((2 * 30 + 4) * 3 + 2) * 3 + 1])));
  std::ifstream about(out() / "about.json");
  EXPECT_EQ(nlohmann::json::parse(about).at("rooms"), (nlohmann::json{{"0", "office"}, {"1", "corridor"}}));
}

TEST_F(PublishedSet, OneSplitByEitherName) {
  write_published_split(root(), "train", {"S11_01_10"});
  write_published_split(root(), "test", {"S12_01_11"});
  EXPECT_EQ(converted({.split = "test_data", .env_map = {}}).windows, 1u);
  EXPECT_EQ(open_window_folder(out())->people(0).size(), 2u);
  fs::remove_all(out());
  EXPECT_EQ(converted({.split = "train", .env_map = {}}).windows, 1u);
  EXPECT_EQ(read_npy<std::uint8_t>(out() / "room.npy").data, std::vector<std::uint8_t>{1});
  fs::remove_all(out());
  EXPECT_NE(refusal({.split = "val", .env_map = {}}).find("has no split \"val\""), std::string::npos);
}

TEST_F(PublishedSet, WarnsOfWhatIsOdd) {
  write_published_split(root(), "train", {"S11_01_10", "S12_01_11"});
  fs::copy_file(root() / "train_data/keypoint/S11_01_10.npy", root() / "train_data/keypoint/S12_01_11.npy",
                fs::copy_options::overwrite_existing);
  std::ofstream(root() / "train_data/train_data_list.txt")
      << "S11_01_10 1\nS11_01_10\nS12_01_11\n\nS99_99_99\n";
  EXPECT_EQ(converted().windows, 2u);
  ASSERT_EQ(warnings_.size(), 4u);
  EXPECT_NE(warnings_[0].find("test_data_list.txt is missing"), std::string::npos);
  EXPECT_NE(warnings_[1].find("1 lines after it are not read"), std::string::npos);
  EXPECT_NE(warnings_[2].find("1 names are listed more than once"), std::string::npos);
  EXPECT_EQ(warnings_[3], "S12_01_11: 1 people are labelled, the name says 2; the labels are taken");
}

TEST_F(PublishedSet, StopsAtABrokenFileOrLeavesItOut) {
  write_published_split(root(), "train", {"S11_01_10", "S11_01_11", "S13_01_12"});
  fs::resize_file(root() / "train_data/csi/S11_01_11.mat", 700);
  fs::remove(root() / "train_data/keypoint/S13_01_12.npy");
  EXPECT_NE(refusal().find("S11_01_11.mat: "), std::string::npos);
  warnings_.clear();
  const Converted done = converted({.split = "train", .env_map = {}, .skip_broken = true});
  EXPECT_EQ(done.windows, 1u);
  EXPECT_EQ(done.left_out.broken, 2u);
  ASSERT_EQ(warnings_.size(), 2u);
  EXPECT_NE(warnings_[1].find("cannot read"), std::string::npos) << warnings_[1];
  EXPECT_NE(warnings_[1].find("S13_01_12.npy: No such file"), std::string::npos) << warnings_[1];
}

TEST_F(PublishedSet, SaysWhatTheFolderLacks) {
  EXPECT_NE(refusal().find("is not there"), std::string::npos);
  fs::create_directories(root() / "train_data" / "csi");
  EXPECT_NE(refusal().find("is no data set: "), std::string::npos);
  std::ofstream(root() / "train_data/train_data_list.txt") << "S11_01_10\n";
  EXPECT_NE(refusal().find("train_data: lacks the folder keypoint"), std::string::npos);
  fs::create_directories(root() / "train_data" / "keypoint");
  EXPECT_NE(refusal().find("S11_01_10.mat: No such file"), std::string::npos);
  std::ofstream(root() / "train_data/train_data_list.txt") << "\n\n";
  EXPECT_NE(refusal().find("names no window"), std::string::npos);
  std::ofstream(root() / "train_data/train_data_list.txt") << "passwd\n";
  EXPECT_NE(refusal().find("line 1: \"passwd\" is no name"), std::string::npos);
  write_published_split(root(), "train", {"S21_01_10"});
  std::ofstream(folder_ / "map.json") << R"({"office": ["1"]})";
  EXPECT_NE(refusal({.split = "", .env_map = folder_ / "map.json"})
                .find("scene 2 of S21_01_10 is in no environment"),
            std::string::npos);
}

}  // namespace
}  // namespace csipose::train
