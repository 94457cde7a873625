#include "proto/npy.h"

#include <gtest/gtest.h>
#include <unistd.h>

#include <fstream>
#include <numeric>

#include "tests/shared_data.h"

namespace csipose {
namespace {

namespace fs = std::filesystem;

class TemporaryFolder : public ::testing::Test {
 protected:
  TemporaryFolder() : folder_(fs::temp_directory_path() / ("npy_test." + std::to_string(::getpid()))) {
    fs::create_directories(folder_);
  }
  ~TemporaryFolder() override { fs::remove_all(folder_); }
  fs::path folder_;
};
using Npy = TemporaryFolder;

std::vector<std::uint8_t> file_with(const std::string& header, std::size_t data_bytes, char major = 1) {
  std::vector<std::uint8_t> file = {0x93, 'N', 'U', 'M', 'P', 'Y', static_cast<std::uint8_t>(major), 0};
  file.resize(major == 2 ? 12 : 10);
  file[8] = static_cast<std::uint8_t>(header.size());
  file[9] = static_cast<std::uint8_t>(header.size() >> 8);
  file.insert(file.end(), header.begin(), header.end());
  for (std::size_t i = 0; i < data_bytes; ++i) file.push_back(static_cast<std::uint8_t>(i));
  return file;
}

template <class T>
std::string refusal(const std::vector<std::uint8_t>& file) {
  const auto array = parse_npy_as<T>(file);
  return array ? "accepted" : array.error();
}

TEST_F(Npy, ReadsWhatItWrote) {
  const std::vector<float> data = {1, 2, 3, 4, 5, -6.5f};
  write_npy<float>(folder_ / "a.npy", {2, 3}, data);
  const auto array = read_npy<float>(folder_ / "a.npy");
  EXPECT_EQ(array.shape, (NpyShape{2, 3}));
  EXPECT_EQ(array.data, data);
}

TEST_F(Npy, WritesTheHeaderThatNumPyWrites) {
  write_npy<float>(folder_ / "a.npy", {3}, std::vector<float>{1, 2, 3});
  std::ifstream file(folder_ / "a.npy", std::ios::binary);
  const std::string bytes((std::istreambuf_iterator<char>(file)), std::istreambuf_iterator<char>());
  ASSERT_EQ(bytes.size(), 128u + 12);
  std::string header = std::string("\x93NUMPY\x01\x00\x76\x00", 10) +
                       "{'descr': '<f4', 'fortran_order': False, 'shape': (3,), }";
  header.resize(127, ' ');
  EXPECT_EQ(bytes.substr(0, 128), header + "\n");
}

TEST_F(Npy, KeepsNumPysBytes) {
  CSIPOSE_NEEDS_SHARED_DATA();
  const auto golden = testing::shared_data("csi5300/expected/sample_0x1_ap/csi_raw.npy");
  const auto array = read_npy<std::int8_t>(golden);
  write_npy<std::int8_t>(folder_ / "again.npy", array.shape, array.data);
  EXPECT_EQ(npy_detail::read_whole(folder_ / "again.npy"), npy_detail::read_whole(golden));
}

TEST_F(Npy, GrowsRowByRow) {
  NpyWriter<std::int32_t> writer(folder_ / "rows.npy", {2});
  EXPECT_FALSE(fs::exists(folder_ / "rows.npy"));
  for (std::int32_t i = 0; i < 5; ++i) writer.append(std::vector<std::int32_t>{i, -i});
  writer.finish();
  const auto array = read_npy<std::int32_t>(folder_ / "rows.npy");
  EXPECT_EQ(array.shape, (NpyShape{5, 2}));
  EXPECT_EQ(array.data[8], 4);
  EXPECT_EQ(array.data[9], -4);
}

TEST_F(Npy, LeavesNothingBehindWhenNotFinished) {
  { NpyWriter<float>(folder_ / "half.npy", {1}).append(std::vector<float>{1}); }
  EXPECT_TRUE(fs::is_empty(folder_));
}

TEST_F(Npy, ReadsFortranOrder) {
  // 2 x 3, column after column: 0 1 | 2 3 | 4 5
  const auto file = file_with("{'descr': '|u1', 'fortran_order': True, 'shape': (2, 3), }\n", 6);
  const auto array = parse_npy_as<std::uint8_t>(file);
  ASSERT_TRUE(array);
  EXPECT_EQ(array->data, (std::vector<std::uint8_t>{0, 2, 4, 1, 3, 5}));
}

TEST_F(Npy, ReadsScalarsEmptyArraysAndVersionTwo) {
  EXPECT_EQ(parse_npy_as<std::uint8_t>(file_with("{'descr':'|u1','fortran_order':False,'shape':()}", 1))
                ->data.size(),
            1u);
  const auto empty =
      parse_npy_as<float>(file_with("{'shape': (0, 5), 'fortran_order': False, 'descr': \"<f4\"}", 0, 2));
  ASSERT_TRUE(empty);
  EXPECT_EQ(empty->shape, (NpyShape{0, 5}));
}

TEST_F(Npy, SaysWhyItRefuses) {
  const std::string good = "{'descr': '<f4', 'fortran_order': False, 'shape': (2,), }";
  EXPECT_EQ(refusal<float>(file_with(good, 8)), "accepted");
  EXPECT_EQ(refusal<float>(file_with(good, 7)), "its header promises 8 bytes of numbers and 7 are there");
  EXPECT_EQ(refusal<float>(file_with(good, 9)), "its header promises 8 bytes of numbers and 9 are there");
  EXPECT_EQ(refusal<double>(file_with(good, 8)), "its numbers are of type <f4, wanted <f8");
  EXPECT_EQ(refusal<float>(file_with(good, 8, 3)), "it is of version 3; versions 1 and 2 are known");
  EXPECT_EQ(refusal<float>({'P', 'K', 3, 4}), "it is not a NumPy array file (.npy)");
  const auto whole = file_with(good, 8);
  EXPECT_EQ(refusal<float>({whole.begin(), whole.begin() + 30}), "it ends inside its header");
}

TEST_F(Npy, RefusesHeadersThatNumPyWouldNotWrite) {
  for (const char* header : {"", "{", "{}", "[]", "{'descr': '<f4', 'fortran_order': False}",
                             "{'descr': '>f4', 'fortran_order': False, 'shape': (1,)}",
                             "{'descr': '|O', 'fortran_order': False, 'shape': (1,)}",
                             "{'descr': [('a', '<f4')], 'fortran_order': False, 'shape': (1,)}",
                             "{'descr': '<f4', 'fortran_order': False, 'shape': (1)}",
                             "{'descr': '<f4', 'fortran_order': False, 'shape': (-1,)}",
                             "{'descr': '<f4', 'fortran_order': 0, 'shape': (1,)}",
                             "{'descr': '<f4', 'fortran_order': False, 'shape': (1,)} x",
                             "{'descr': '<f4', 'descr': '<f4', 'fortran_order': False, 'shape': (1,)}",
                             "{'descr': '<f4' 'fortran_order': False, 'shape': (1,)}",
                             "{'descr': '<f4', 'fortran_order': False, 'shape': (1,), 'more': 1}",
                             "{'descr': '<f4', 'fortran_order': False, 'shape': (4294967296, 4294967296)}",
                             "{'descr': '<f4', 'fortran_order': False, 'shape': (99999999999999999999999,)}"})
    EXPECT_NE(refusal<float>(file_with(header, 4)), "accepted") << header;
}

TEST_F(Npy, NamesTheFileThatItCannotUse) {
  try {
    read_npy<float>(folder_ / "absent.npy");
    FAIL();
  } catch (const SetupError& error) {
    EXPECT_EQ(error.status, ExitStatus::no_input);
    EXPECT_NE(std::string(error.what()).find("absent.npy: No such file"), std::string::npos) << error.what();
  }
  std::ofstream(folder_ / "text.npy") << "hello";
  EXPECT_THROW(read_npy<float>(folder_ / "text.npy"), SetupError);
  EXPECT_THROW(write_npy<float>(folder_ / "no_such_folder/a.npy", {1}, std::vector<float>{1}), SetupError);
}

}  // namespace
}  // namespace csipose
