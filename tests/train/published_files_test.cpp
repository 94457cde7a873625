// Names, lists, labels and environments of the published data set, well-formed and not.
#include "train/published_files.h"

#include "proto/npy.h"
#include "tests/shared_data.h"

namespace csipose::train {
namespace {

std::vector<std::uint8_t> bytes_of(const std::filesystem::path& path) { return npy_detail::read_whole(path); }
std::string_view text_of(const std::vector<std::uint8_t>& bytes) {
  return {reinterpret_cast<const char*>(bytes.data()), bytes.size()};
}
std::string list_error(std::string_view text) {
  const auto list = parse_name_list(text);
  return list ? "none" : list.error();
}

TEST(WindowName, SaysScenePeopleClipAndFrame) {
  const auto name = parse_window_name("S23_12_337");
  ASSERT_TRUE(name);
  EXPECT_EQ(name->scene, 2u);
  EXPECT_EQ(name->people, 3u);
  EXPECT_EQ(name->clip, 12u);
  EXPECT_EQ(name->frame, 337u);
  EXPECT_EQ(name->clip_number(), 2312u);
  EXPECT_EQ(parse_window_name("S11_01_0")->clip_number(), 1101u);
}

TEST(WindowName, NothingElseIsOne) {
  for (const char* text : {"",
                           "S",
                           "S2",
                           "S23",
                           "S23_",
                           "S23_1",
                           "S23_12",
                           "S23_12_",
                           "S23_12_a",
                           "S23_1_337",
                           "S23_123_337",
                           "s23_12_337",
                           "S2_12_337",
                           "S233_12_337",
                           "S23_12_337x",
                           "S23_12_-1",
                           "../S23_12_337",
                           "S23_12_337/",
                           "S23_12_1234567890",
                           "S23-12-337"})
    EXPECT_FALSE(parse_window_name(text)) << text;
}

TEST(NameList, FirstFieldCountsAndTheFirstEmptyLineEnds) {
  const auto list = parse_name_list(" S11_01_10 0 1\r\nS12_03_45\t7\n \t\r\nS99_99_99\nno name\n\n");
  ASSERT_TRUE(list) << list.error();
  ASSERT_EQ(list->names.size(), 2u);
  EXPECT_EQ(list->names[0].text, "S11_01_10");
  EXPECT_EQ(list->names[1].text, "S12_03_45");
  EXPECT_EQ(list->after_end, 2u);
  EXPECT_EQ(parse_name_list("S11_01_10")->names.size(), 1u);  // without a newline
  EXPECT_EQ(parse_name_list("")->names.size(), 0u);
  EXPECT_EQ(parse_name_list("S11_01_10\n\n")->after_end, 0u);
}

TEST(NameList, SaysWhichLineIsWrong) {
  EXPECT_EQ(list_error("S11_01_10\n../../etc/passwd 1\n"),
            "line 2: \"../../etc/passwd\" is no name such as S23_12_337");
  EXPECT_EQ(list_error("\x01\xff\n"), "line 1: \"??\" is no name such as S23_12_337");
}

TEST(NameList, TheSharedOne) {
  CSIPOSE_NEEDS_SHARED_DATA();
  const auto bytes = bytes_of(testing::shared_data("model/piw3d_robust/list_trailing_columns.txt"));
  const auto list = parse_name_list(text_of(bytes));
  ASSERT_TRUE(list) << list.error();
  ASSERT_EQ(list->names.size(), 2u);
  EXPECT_EQ(list->names[0].text, "S11_01_10");
  EXPECT_EQ(list->names[1].text, "S12_03_45");
  EXPECT_EQ(list->after_end, 1u);
}

/// A .npy of zeros.
std::vector<std::uint8_t> npy(const std::string& descr, const std::string& shape, std::size_t bytes) {
  std::string text = "{'descr': '" + descr + "', 'fortran_order': False, 'shape': " + shape + ", }\n";
  std::string file = "\x93NUMPY\x01";
  file += '\0';
  file += static_cast<char>(text.size());
  file += '\0';
  file += text + std::string(bytes, '\0');
  return {file.begin(), file.end()};
}
std::string keypoint_error(const std::vector<std::uint8_t>& file) {
  const auto people = parse_keypoints(file);
  return people ? "none" : people.error();
}

TEST(Keypoints, OneToTenPeopleOfFourteenJoints) {
  EXPECT_EQ(parse_keypoints(npy("<f4", "(2, 14, 3)", 2 * 14 * 3 * 4))->size(), 2u);
  EXPECT_EQ(parse_keypoints(npy("<f8", "(14, 3)", 14 * 3 * 8))->size(), 1u);
  EXPECT_EQ(keypoint_error(npy("<f4", "(0, 14, 3)", 0)), "its shape is (0, 14, 3), wanted (people, 14, 3)");
  EXPECT_NE(keypoint_error(npy("<f4", "(11, 14, 3)", 11 * 14 * 3 * 4)), "none");
  EXPECT_NE(keypoint_error(npy("<f4", "(1, 17, 3)", 17 * 3 * 4)), "none");
  EXPECT_NE(keypoint_error(npy("<f4", "(42,)", 42 * 4)), "none");
  EXPECT_EQ(keypoint_error(npy("<i4", "(14, 3)", 14 * 3 * 4)),
            "its numbers are of type <i4, wanted <f8 or <f4");
  EXPECT_NE(keypoint_error(npy("<f4", "(14, 3)", 14 * 3 * 4 - 1)), "none");
}

TEST(Keypoints, TheSharedOnes) {
  CSIPOSE_NEEDS_SHARED_DATA();
  const auto read = [](const char* name) {
    return parse_keypoints(bytes_of(testing::shared_data(std::string("model/piw3d_robust/") + name)));
  };
  EXPECT_EQ(keypoint_error(bytes_of(testing::shared_data("model/piw3d_robust/kp_bad_13.npy")))
                .find("its shape is ("),
            0u);
  EXPECT_EQ(keypoint_error(bytes_of(testing::shared_data("model/piw3d_robust/kp_nan.npy"))),
            "it holds a number that is not finite");
  const auto fortran = read("kp_fortran_f4.npy"), c = read("kp_c_f8_same_as_fortran.npy"),
             one = read("kp_2d_14x3.npy");
  ASSERT_TRUE(fortran && c && one);
  EXPECT_EQ(one->size(), 1u);
  ASSERT_EQ(fortran->size(), c->size());
  for (std::size_t p = 0; p < c->size(); ++p)
    for (std::size_t j = 0; j < kJoints; ++j) {
      EXPECT_EQ((*fortran)[p][j].x, (*c)[p][j].x);
      EXPECT_EQ((*fortran)[p][j].y, (*c)[p][j].y);
      EXPECT_EQ((*fortran)[p][j].z, (*c)[p][j].z);
    }
}

TEST(Environments, NumberedInTheOrderOfTheFile) {
  const auto map = EnvironmentMap::parse(R"({"office": ["1"], "classroom": ["2", "5"], "corridor": ["3"]})");
  ASSERT_TRUE(map) << map.error();
  EXPECT_EQ(map->of_scene(1), 0);
  EXPECT_EQ(map->of_scene(5), 1);
  EXPECT_EQ(map->of_scene(3), 2);
  EXPECT_EQ(map->of_scene(4), std::nullopt);
  EXPECT_EQ(map->names().at(1), "classroom");
  EXPECT_EQ(EnvironmentMap().of_scene(5), 5);
  EXPECT_EQ(EnvironmentMap().names().at(5), "scene5");
}

TEST(Environments, SaysWhatIsWrong) {
  const auto error = [](std::string_view json) {
    const auto map = EnvironmentMap::parse(json);
    return map ? "none" : map.error();
  };
  EXPECT_NE(error("").find("no JSON object"), std::string::npos);
  EXPECT_NE(error("{}").find("no JSON object"), std::string::npos);
  EXPECT_EQ(error(R"({"a": "1"})"), "environment \"a\" is no list of digits");
  EXPECT_EQ(error(R"({"a": [1]})"), "environment \"a\": a scene is a digit in quotes");
  EXPECT_EQ(error(R"({"a": ["1"], "b": ["1"]})"), "scene 1 is in two environments");
  EXPECT_EQ(error(R"({"../a": ["1"]})"), "environment \"../a\" cannot be a folder's name");
}

}  // namespace
}  // namespace csipose::train
