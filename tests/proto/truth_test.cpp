#include "proto/truth.h"

#include <gtest/gtest.h>

namespace csipose {
namespace {

TruthHello hello() {
  TruthHello hello;
  hello.scene = "office, 2 people: walk";
  hello.seed = 18446744073709551615U;
  hello.rate_hz = 300;
  hello.speed = 0.5;
  hello.impair = "5300 less losses";
  hello.size_m = {5.6F, 4.8F, 2.8F};
  hello.transmitter_m = {0.65F, 2.4F, 1.2F};
  hello.receivers_m = {{1, 2, 3}, {4, 5, 6}, {7, 8, 9}};
  return hello;
}

Truth truth() {
  Truth truth{42, 0.136667, UtcTime{Nanoseconds{1790000000123456789}}, {}, 3};
  for (std::uint32_t id = 1; id <= 2; ++id) {
    truth.people.push_back({id, {}});
    for (std::size_t j = 0; j < kJoints; ++j)
      truth.people.back().joints[j] = {0.125F * static_cast<float>(j), -0.5F * static_cast<float>(id),
                                       1.0625F};
  }
  return truth;
}

std::string without_newline(std::string line) {
  EXPECT_EQ(line.back(), '\n');
  line.pop_back();
  EXPECT_EQ(line.find('\n'), std::string::npos);
  return line;
}

std::string replaced(std::string line, const std::string& part, const std::string& by) {
  const auto at = line.find(part);
  EXPECT_NE(at, std::string::npos) << part;
  return line.replace(at, part.size(), by);
}

TEST(TruthLines, SayAgainWhatWasSaid) {
  const auto read = parse_truth(without_newline(encode(truth())));
  ASSERT_TRUE(read.has_value()) << read.error();
  const Truth& back = std::get<Truth>(*read);
  EXPECT_EQ(back.counter, 42U);
  EXPECT_NEAR(back.simulated_s, 0.136667, 1e-9);
  EXPECT_EQ(ns(back.sent), 1790000000123456789) << "to the nanosecond";
  EXPECT_EQ(back.dropped_before, 3U);
  ASSERT_EQ(back.people.size(), 2U);
  EXPECT_EQ(back.people[1].id, 2U);
  for (std::size_t j = 0; j < kJoints; ++j) {
    EXPECT_EQ(back.people[1].joints[j].x, 0.125F * static_cast<float>(j));
    EXPECT_EQ(back.people[1].joints[j].y, -1.0F);
    EXPECT_EQ(back.people[1].joints[j].z, 1.0625F);
  }
}

TEST(TruthLines, BeginWithAHello) {
  const auto read = parse_truth(without_newline(encode(hello())));
  ASSERT_TRUE(read.has_value()) << read.error();
  const TruthHello& back = std::get<TruthHello>(*read);
  EXPECT_EQ(back.scene, hello().scene);
  EXPECT_EQ(back.seed, hello().seed);
  EXPECT_EQ(back.speed, 0.5);
  EXPECT_EQ(back.impair, "5300 less losses");
  EXPECT_EQ(back.size_m.y, 4.8F);
  ASSERT_EQ(back.receivers_m.size(), 3U);
  EXPECT_EQ(back.receivers_m[2].z, 9);
}

TEST(TruthLines, NobodyIsAListOfNone) {
  Truth empty = truth();
  empty.people.clear();
  EXPECT_TRUE(std::get<Truth>(*parse_truth(without_newline(encode(empty)))).people.empty());
}

TEST(TruthLines, WhatIsNoTruthIsRefusedWithWords) {
  const std::string line = without_newline(encode(truth())), first = without_newline(encode(hello()));
  for (const auto& [wrong, words] : std::vector<std::pair<std::string, std::string>>{
           {"", "no JSON"},
           {line.substr(0, line.size() - 1), "no JSON"},
           {"[1]", "no JSON object"},
           {R"({"type":7})", "type is no text"},
           {R"({"type":"pose"})", "'pose' is not known"},
           {replaced(line, "\"counter\":42", "\"counter\":-1"), "counter is no count"},
           {replaced(line, "1790000000123456789", "179e5"), "utc_ns is no time"},
           {replaced(line, "[0.0000,-0.5000,1.0625],", ""), "13 joints where 14 are due"},
           {replaced(line, "[0.0000,-0.5000,1.0625]", "[0.0,null,1.0]"), "joints is no point"},
           {replaced(line, "[0.0000,-0.5000,1.0625]", "[0.0,1e300,1.0]"), "joints is no point"},
           {replaced(first, "\"api\":\"1.0\"", "\"api\":\"2.0\""), "another version"},
           {replaced(first, "\"neck\",\"head\"", "\"head\",\"neck\""), "joints are not ours"},
           {replaced(first, "\"room\":{", "\"room\":[],\"x\":{"), "size_m is missing"},
           {std::string(kMaxTruthLine + 1, ' '), "longer"}}) {
    const auto read = parse_truth(wrong);
    ASSERT_FALSE(read.has_value()) << wrong;
    EXPECT_NE(read.error().find(words), std::string::npos) << wrong << ": " << read.error();
  }
}

}  // namespace
}  // namespace csipose
