#include "model/safetensors.h"

#include <gtest/gtest.h>

#include <cmath>
#include <cstring>
#include <filesystem>
#include <fstream>

#include "proto/npy.h"
#include "proto/result.h"
#include "tests/shared_data.h"

namespace csipose {
namespace {

std::vector<std::uint8_t> file_of(const std::string& header, std::size_t data_bytes) {
  std::vector<std::uint8_t> bytes(8 + header.size() + data_bytes);
  store_le<std::uint64_t>(bytes.data(), header.size());
  std::copy(header.begin(), header.end(), bytes.begin() + 8);
  return bytes;
}

std::string refusal(std::vector<std::uint8_t> bytes) {
  try {
    SafetensorsFile::parse(std::move(bytes), "some.safetensors");
  } catch (const SetupError& error) {
    EXPECT_EQ(error.status, ExitStatus::bad_data);
    EXPECT_NE(std::string(error.what()).find("some.safetensors"), std::string::npos) << error.what();
    return error.what();
  }
  return "";
}
std::string refusal(const std::string& header, std::size_t data_bytes) {
  return refusal(file_of(header, data_bytes));
}

/// What a header says, in one order: two files with equal meaning compare equal.
std::string meaning(const SafetensorsFile& file) {
  std::string text;
  for (const auto& [key, value] : file.metadata()) text += key + "=" + value + "\n";
  for (const TensorView& tensor : file.tensors())
    text += tensor.name + std::string(name_of(tensor.dtype)) + shape_text(tensor.shape) +
            std::string(reinterpret_cast<const char*>(tensor.bytes.data()), tensor.bytes.size()) + "\n";
  return text;
}

const float kNumbers[6] = {1, -2.5f, 3e-8f, 0, 7, 1e30f};
std::vector<std::uint8_t> small_file() {
  return pack_safetensors({{"made", "here"}, {"quote", "a \"b\" \\ \xc3\xa9"}},
                          {{"w", DType::f32, {2, 2}, ByteView(kNumbers, 16)},
                           {"none", DType::f32, {0, 5}, {}},
                           {"b", DType::f32, {}, ByteView(kNumbers + 4, 4)}});
}

/// As NumPy writes a tuple.
std::string tuple_text(const std::vector<std::size_t>& shape) {
  std::string text = shape_text(shape);
  text.front() = '(';
  text.back() = ')';
  if (shape.size() == 1) text.insert(text.size() - 1, ",");
  return text;
}

TEST(Safetensors, GoldenFileHasTheArraysBesideIt) {
  CSIPOSE_NEEDS_SHARED_DATA();
  const SafetensorsFile file =
      SafetensorsFile::read(testing::shared_data("model/safetensors_basic/basic.safetensors"));
  EXPECT_EQ(file.metadata().at("note"), "golden");
  EXPECT_FALSE(file.sealed());
  ASSERT_EQ(file.tensors().size(), 6u);
  for (const TensorView& tensor : file.tensors()) {
    std::ifstream stream(testing::shared_data("model/safetensors_basic/" + tensor.name + ".npy"),
                         std::ios::binary);
    const std::string npy((std::istreambuf_iterator<char>(stream)), {});
    const std::string shape =
        tensor.name == "scalar" ? "()" : tuple_text(tensor.shape);  // there it is stored as [1]
    EXPECT_NE(npy.find("'shape': " + shape), std::string::npos) << tensor.name << shape;
    ASSERT_GT(npy.size(), tensor.bytes.size());
    EXPECT_EQ(
        std::memcmp(npy.data() + npy.size() - tensor.bytes.size(), tensor.bytes.data(), tensor.bytes.size()),
        0)
        << tensor.name;
  }
}

TEST(Safetensors, GoldenWeightsHaveTheArraysBesideThem) {
  CSIPOSE_NEEDS_SHARED_DATA();
  const SafetensorsFile file =
      SafetensorsFile::read(testing::shared_data("model/vit_tiny/weights.safetensors"));
  ASSERT_EQ(file.tensors().size(), 28u);
  for (const TensorView& tensor : file.tensors()) {
    const auto array =
        read_npy<float>(testing::shared_data("model/vit_tiny/weights_npy/" + tensor.name + ".npy"));
    EXPECT_EQ(array.shape, tensor.shape) << tensor.name;
    EXPECT_EQ(array.data, to_floats(tensor)) << tensor.name;
  }
}

TEST(Safetensors, WhatIsPackedIsReadBack) {
  const SafetensorsFile file = SafetensorsFile::parse(small_file(), "small");
  EXPECT_TRUE(file.sealed());
  EXPECT_EQ(file.metadata().at("quote"), "a \"b\" \\ \xc3\xa9");
  ASSERT_NE(file.find("w"), nullptr);
  EXPECT_EQ(file.find("w")->shape, (std::vector<std::size_t>{2, 2}));
  EXPECT_EQ(to_floats(*file.find("w")), std::vector<float>(kNumbers, kNumbers + 4));
  EXPECT_EQ(to_floats(*file.find("b")), std::vector<float>{7});
  EXPECT_EQ(file.find("none")->elements(), 0u);
  EXPECT_EQ(file.find("nothing"), nullptr);
}

TEST(Safetensors, DigestIsThatOfTheBytes) {
  // SHA-256 of these ten bytes by sha256sum.
  EXPECT_EQ(SafetensorsFile::parse(file_of("{}", 0), "empty").digest(),
            "411a485216e432ece6b9af94fa32154cf79a2a56d4f81266baa50063f45092bd");
}

// Every byte of the file, every bit of it: refused, or it says the same as before.
TEST(Safetensors, EachFlippedBitIsRefusedOrMeansTheSame) {
  const std::vector<std::uint8_t> good = small_file();
  const std::string meant = meaning(SafetensorsFile::parse(good, "good"));
  std::size_t refused = 0;
  for (std::size_t bit = 0; bit < 8 * good.size(); ++bit) {
    std::vector<std::uint8_t> bad = good;
    bad[bit / 8] ^= static_cast<std::uint8_t>(1 << bit % 8);
    try {
      const SafetensorsFile file = SafetensorsFile::parse(bad, "bad");
      EXPECT_TRUE(!file.sealed() || meaning(file) == meant) << "byte " << bit / 8 << " bit " << bit % 8;
    } catch (const SetupError&) {
      ++refused;
    }
  }
  EXPECT_GT(refused, 8 * good.size() * 9 / 10);
}

TEST(Safetensors, EachTruncationIsRefused) {
  const std::vector<std::uint8_t> good = small_file();
  for (std::size_t size = 0; size < good.size(); ++size)
    EXPECT_NE(
        refusal(std::vector<std::uint8_t>(good.begin(), good.begin() + static_cast<std::ptrdiff_t>(size))),
        "");
  std::vector<std::uint8_t> longer = good;
  longer.push_back(0);
  EXPECT_NE(refusal(longer), "");
}

TEST(Safetensors, RefusesHeadersThatDoNotDescribeTheData) {
  const auto entry = [](const std::string& rest) { return "{\"a\":{" + rest + "}}"; };
  const std::string one = R"("dtype":"F32","shape":[1],"data_offsets":[0,4])";
  EXPECT_EQ(refusal(entry(one), 4), "");
  EXPECT_NE(refusal(entry(one), 5).find("belong to no tensor"), std::string::npos);
  EXPECT_NE(refusal(entry(one), 3).find("'a'"), std::string::npos);
  const std::pair<std::string, const char*> cases[] = {
      {R"("dtype":"F32","shape":[2],"data_offsets":[0,4])", "takes 8"},
      {R"("dtype":"F64","shape":[1],"data_offsets":[0,4])", "takes 8"},
      {R"("dtype":"F33","shape":[1],"data_offsets":[0,4])", "F33"},
      {R"("dtype":[[[]]],"shape":[1],"data_offsets":[0,4])", "number type of type array"},
      {R"("dtype":"F32","shape":[-1],"data_offsets":[0,4])", "extent -1"},
      {R"("dtype":"F32","shape":[1.0],"data_offsets":[0,4])", "extent 1.0"},
      {R"("dtype":"F32","shape":1,"data_offsets":[0,4])", "no list"},
      {R"("dtype":"F32","shape":[4294967296,4294967296,4],"data_offsets":[0,4])", "larger than memory"},
      {R"("dtype":"F32","shape":[1],"data_offsets":[4,0])", "lies at"},
      {R"("dtype":"F32","shape":[1],"data_offsets":[0,4,4])", "two whole numbers"},
      {R"("dtype":"F32","shape":[1],"data_offsets":[0,18446744073709551615])", "lies at"},
      {R"("dtype":"F32","shape":[1])", "other than"},
      {R"("dtype":"F32","shape":[1],"data_offsets":[0,4],"more":1)", "other than"},
      {R"("dtype":"F32","shape":[1],"shape":[1],"data_offsets":[0,4])", "twice"}};
  for (const auto& [rest, words] : cases)
    EXPECT_NE(refusal(entry(rest), 4).find(words), std::string::npos) << refusal(entry(rest), 4);
}

TEST(Safetensors, RefusesOverlapsAndHoles) {
  const auto two = [](const char* a, const char* b) {
    return std::string(R"({"a":{"dtype":"U8","shape":[4],"data_offsets":)") + a +
           R"(},"b":{"dtype":"U8","shape":[4],"data_offsets":)" + b + "}}";
  };
  EXPECT_EQ(refusal(two("[0,4]", "[4,8]"), 8), "");
  EXPECT_EQ(refusal(two("[4,8]", "[0,4]"), 8), "");
  EXPECT_NE(refusal(two("[0,4]", "[3,7]"), 7).find("overlaps"), std::string::npos);
  EXPECT_NE(refusal(two("[0,4]", "[0,4]"), 4).find("overlaps"), std::string::npos);
  EXPECT_NE(refusal(two("[0,4]", "[5,9]"), 9).find("hole"), std::string::npos);
  EXPECT_NE(refusal(two("[1,5]", "[5,9]"), 9).find("hole"), std::string::npos);
}

TEST(Safetensors, RefusesOddHeaders) {
  EXPECT_EQ(refusal("{}   ", 0), "");
  EXPECT_NE(refusal("", 0), "");
  EXPECT_NE(refusal("[]", 0), "");
  EXPECT_NE(refusal(" {}", 0), "");
  EXPECT_NE(refusal("{} x", 0), "");
  EXPECT_NE(refusal(std::string("{}\0\0", 4), 0).find("NUL"), std::string::npos);
  EXPECT_NE(refusal(R"({"__metadata__":{"a":1}})", 0).find("'a'"), std::string::npos);
  EXPECT_NE(refusal(R"({"__metadata__":[]})", 0), "");
  EXPECT_NE(
      refusal(
          R"({"a":{"dtype":"U8","shape":[0],"data_offsets":[0,0]},"a":{"dtype":"U8","shape":[0],"data_offsets":[0,0]}})",
          0)
          .find("twice"),
      std::string::npos);
  std::vector<std::uint8_t> huge = file_of("{}", 0);
  store_le<std::uint64_t>(huge.data(), UINT64_MAX);
  EXPECT_NE(refusal(huge).find("claims"), std::string::npos);
}

// A thousand levels deep in each place where a value may stand: no recursion of ours follows it down.
TEST(Safetensors, DeepNestingIsRefused) {
  const std::string deep = std::string(100'000, '[') + std::string(100'000, ']');
  EXPECT_NE(refusal("{\"a\":" + deep + "}", 0), "");
  EXPECT_NE(refusal("{\"a\":{\"dtype\":" + deep + ",\"shape\":[],\"data_offsets\":[0,4]}}", 4), "");
  EXPECT_NE(refusal("{\"a\":{\"dtype\":\"U8\",\"shape\":[" + deep + "],\"data_offsets\":[0,4]}}", 4), "");
  EXPECT_NE(refusal("{\"__metadata__\":{\"a\":" + deep + "}}", 0), "");
}

// All 65536 half-precision numbers against their definition.
TEST(Safetensors, HalfPrecisionIsExact) {
  std::vector<std::uint8_t> bytes(2 * 65536);
  for (std::size_t i = 0; i < 65536; ++i)
    store_le<std::uint16_t>(&bytes[2 * i], static_cast<std::uint16_t>(i));
  const std::vector<float> f16 = to_floats({"h", DType::f16, {65536}, bytes});
  const std::vector<float> bf16 = to_floats({"b", DType::bf16, {65536}, bytes});
  for (std::size_t i = 0; i < 65536; ++i) {
    const int exponent = static_cast<int>(i >> 10 & 31), fraction = static_cast<int>(i & 1023);
    const double sign = i < 32768 ? 1 : -1;
    const double value = exponent == 0 ? fraction / 1024. * std::pow(2., -14)
                                       : (1 + fraction / 1024.) * std::pow(2., exponent - 15);
    if (exponent == 31)
      EXPECT_TRUE(fraction == 0 ? std::isinf(f16[i]) && (f16[i] > 0) == (sign > 0) : std::isnan(f16[i])) << i;
    else
      EXPECT_EQ(static_cast<double>(f16[i]), sign * value) << i;
    std::uint32_t bits;
    std::memcpy(&bits, &bf16[i], 4);
    EXPECT_EQ(bits, i << 16);
  }
}

TEST(Safetensors, DoubleIsRounded) {
  const double numbers[2] = {0.1, -1e300};
  const std::vector<float> floats = to_floats({"d", DType::f64, {2}, ByteView(numbers, 16)});
  EXPECT_EQ(floats[0], 0.1f);
  EXPECT_TRUE(std::isinf(floats[1]));
}

TEST(Safetensors, WritingReplacesInOneStep) {
  const auto folder = std::filesystem::path(::testing::TempDir()) / "csipose_safetensors_test";
  std::filesystem::remove_all(folder);
  std::filesystem::create_directories(folder);
  const auto path = folder / "w.safetensors";
  const std::vector<std::uint8_t> bytes = small_file();
  write_file_atomically(path, ByteView("old", 3));
  write_file_atomically(path, bytes);
  EXPECT_EQ(meaning(SafetensorsFile::read(path)), meaning(SafetensorsFile::parse(bytes, "x")));
  EXPECT_EQ(std::distance(std::filesystem::directory_iterator(folder), {}), 1);
  std::filesystem::remove_all(folder);
}

TEST(Safetensors, MissingFilesAndFoldersAreNamed) {
  const auto status_of = [](auto&& action) {
    try {
      action();
    } catch (const SetupError& error) {
      EXPECT_NE(std::string(error.what()).find("/nowhere"), std::string::npos) << error.what();
      return error.status;
    }
    return ExitStatus::ok;
  };
  EXPECT_EQ(status_of([] { SafetensorsFile::read("/nowhere/w.safetensors"); }), ExitStatus::no_input);
  EXPECT_EQ(status_of([] { write_file_atomically("/nowhere/w.safetensors", ByteView("x", 1)); }),
            ExitStatus::cannot_create);
}

}  // namespace
}  // namespace csipose
