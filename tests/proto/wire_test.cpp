#include "proto/wire.h"

#include <gtest/gtest.h>

#include <cmath>
#include <nlohmann/json.hpp>

#include "tests/daemon/pose_frames.h"

namespace csipose {
namespace {

using testing::frame_with;
using testing::message_bytes;

const std::vector<std::string> kIds = {"rx1", "rx2", "rx3"};

/// One client's message, as it goes over the socket, read back.
ReceivedPose round_trip(const PoseFrame& frame, Level level, Format format, std::uint32_t dropped = 0) {
  FrameEncoder encoder(kIds);
  auto message = parse_server_message(format, message_bytes(encoder, frame, level, format, dropped));
  EXPECT_TRUE(message.has_value());
  return std::get<ReceivedPose>(*message);
}

nlohmann::json json_of(const PoseFrame& frame, Level level) {
  FrameEncoder encoder(kIds);
  return nlohmann::json::parse(message_bytes(encoder, frame, level, Format::json, 0));
}

void expect_near(const Skeleton& a, const Skeleton& b, float tolerance) {
  for (std::size_t j = 0; j < kJoints; ++j) {
    EXPECT_NEAR(a[j].x, b[j].x, tolerance);
    EXPECT_NEAR(a[j].y, b[j].y, tolerance);
    EXPECT_NEAR(a[j].z, b[j].z, tolerance);
  }
}

class BothFormats : public ::testing::TestWithParam<Format> {};
INSTANTIATE_TEST_SUITE_P(Wire, BothFormats, ::testing::Values(Format::json, Format::protobuf));

TEST_P(BothFormats, FrameComesBackWhole) {
  PoseFrame frame = frame_with(2);
  frame.smoothed = true;
  const float tolerance = GetParam() == Format::json ? 5.1e-5F : 0;  // four decimals
  const ReceivedPose got = round_trip(frame, Level::pose, GetParam(), 7);
  EXPECT_EQ(got.dropped_before, 7U);
  EXPECT_EQ(got.frame.seq, frame.seq);
  EXPECT_EQ(got.frame.session, frame.session);
  EXPECT_EQ(got.frame.window_start, frame.window_start);
  EXPECT_EQ(got.frame.window_end, frame.window_end);
  EXPECT_EQ(got.frame.published, frame.published);
  EXPECT_EQ(got.frame.mono_ns, frame.mono_ns);
  EXPECT_EQ(got.frame.clock_error_ns, frame.clock_error_ns);
  EXPECT_EQ(got.frame.source, frame.source);
  EXPECT_EQ(got.frame.state, frame.state);
  EXPECT_EQ(got.frame.reasons, frame.reasons);
  EXPECT_EQ(got.frame.model, frame.model);
  EXPECT_TRUE(got.frame.untrained);
  EXPECT_EQ(got.frame.latency_us, frame.latency_us);
  ASSERT_EQ(got.frame.people_count, 2U);
  ASSERT_EQ(got.people_described, 2U);
  for (std::size_t p = 0; p < 2; ++p) {
    const Person &is = got.frame.people[p], &was = frame.people[p];
    EXPECT_EQ(is.id, was.id);
    EXPECT_EQ(is.age_ms, was.age_ms);
    EXPECT_NEAR(is.score, was.score, tolerance);
    expect_near(is.joints, was.joints, tolerance);
    expect_near(is.joints_raw, was.joints_raw, tolerance);
    EXPECT_NEAR(is.confidence[3], was.confidence[3], tolerance);
    EXPECT_TRUE(std::isnan(is.sigma_m[2]));
    EXPECT_NEAR(got.root_m[p].y, was.root().y, tolerance);
  }
  for (std::size_t r = 0; r < kReceivers; ++r) {
    const auto &is = got.frame.receivers[r], &was = frame.receivers[r];
    EXPECT_NEAR(is.rate_hz, was.rate_hz, tolerance);
    EXPECT_NEAR(is.missing_ratio, was.missing_ratio, tolerance);
    EXPECT_EQ(is.last_counter, was.last_counter);
  }
  EXPECT_TRUE(std::isnan(got.frame.receivers[1].rssi_dbm[2]));
}

TEST_P(BothFormats, LevelsLeaveOutWhatTheyMust) {
  const PoseFrame frame = frame_with(2);
  const ReceivedPose presence = round_trip(frame, Level::presence, GetParam());
  EXPECT_EQ(presence.frame.people_count, 2U);
  EXPECT_EQ(presence.people_described, 0U);
  EXPECT_TRUE(std::isnan(presence.frame.receivers[0].rssi_dbm[0]));
  const ReceivedPose position = round_trip(frame, Level::position, GetParam());
  EXPECT_EQ(position.people_described, 2U);
  EXPECT_EQ(position.frame.people[1].id, frame.people[1].id);
  EXPECT_NEAR(position.root_m[1].x, frame.people[1].root().x, 1e-4);
  EXPECT_TRUE(std::isnan(position.frame.people[1].joints[0].x));
  EXPECT_EQ(round_trip(frame, Level::raw, GetParam()).people_described, 2U);
}

TEST_P(BothFormats, RequestsComeBack) {
  Subscription asked;
  asked.pose = true;
  asked.status = true;
  asked.level = Level::position;
  asked.max_hz = 12.5F;
  asked.queue = 5;
  asked.on_full = OnFull::close;
  const auto unframed = [](Format format, std::string bytes) {
    return bytes.substr(format == Format::json ? 0 : 4);
  };
  auto read =
      parse_client_message(GetParam(), unframed(GetParam(), encode(GetParam(), ClientMessage{asked})));
  ASSERT_TRUE(read.has_value());
  const auto& got = std::get<Subscription>(*read);
  EXPECT_TRUE(got.pose && got.status);
  EXPECT_EQ(got.level, Level::position);
  EXPECT_EQ(got.max_hz, 12.5F);
  EXPECT_EQ(got.queue, 5U);
  EXPECT_EQ(got.on_full, OnFull::close);
  read = parse_client_message(GetParam(), unframed(GetParam(), encode(GetParam(), ClientMessage{Ping{99}})));
  ASSERT_TRUE(read.has_value());
  EXPECT_EQ(std::get<Ping>(*read).id, 99U);
}

TEST_P(BothFormats, StatusAndHelloComeBack) {
  const auto unframed = [](Format format, std::string bytes) {
    return bytes.substr(format == Format::json ? 0 : 4);
  };
  Status status = testing::busy_status();
  auto read = parse_server_message(GetParam(), unframed(GetParam(), encode(GetParam(), status)));
  ASSERT_TRUE(read.has_value());
  const auto& got = std::get<ReceivedStatus>(*read);
  EXPECT_EQ(got.status.session, status.session);
  EXPECT_EQ(got.status.config_path, status.config_path);
  EXPECT_EQ(got.status.state, status.state);
  EXPECT_EQ(got.status.reasons, status.reasons);
  ASSERT_EQ(got.status.receivers.size(), 3U);
  EXPECT_EQ(got.status.receivers[1].skew_ppm, status.receivers[1].skew_ppm);
  EXPECT_TRUE(std::isnan(got.status.receivers[2].offset_s));
  EXPECT_EQ(got.status.receivers[1].rejected.at(0).name, "forged");
  EXPECT_EQ(got.status.receivers[1].rejected.at(0).count, 12U);
  ASSERT_EQ(got.latency.size(), 1U);
  EXPECT_EQ(got.latency[0].stage, "infer");
  EXPECT_EQ(got.latency[0].max_ms, 21.0);

  Hello hello;
  hello.name = "kitchen \"north\"";
  hello.session = UINT64_MAX;
  hello.room = {{4, 3.5F, 2.5F}, {0, 1.75F, 1}, {{"rx1", {4, 0.5F, 1}}}};
  hello.clock = "recording";
  read = parse_server_message(GetParam(), unframed(GetParam(), encode(GetParam(), hello)));
  ASSERT_TRUE(read.has_value());
  EXPECT_EQ(std::get<Hello>(*read).name, hello.name);
  EXPECT_EQ(std::get<Hello>(*read).session, UINT64_MAX);
  EXPECT_EQ(std::get<Hello>(*read).room.receivers.at(0).position_m[1], 0.5F);
}

TEST(WireJson, HasTheContractsKeysAndForms) {
  const nlohmann::json line = json_of(frame_with(1), Level::pose);
  EXPECT_EQ(line["type"], "pose");
  EXPECT_EQ(line["seq"], 7);
  EXPECT_EQ(line["t_window_end"], "1790000000000000000");
  EXPECT_EQ(line["source"], "replay");
  EXPECT_EQ(line["state"], "degraded");
  EXPECT_EQ(line["reasons"], nlohmann::json({"rx_missing", "untrained"}));
  EXPECT_EQ(line["people"][0]["joints"].size(), 14U);
  EXPECT_EQ(line["people"][0]["joints"][1].size(), 3U);
  EXPECT_TRUE(line["people"][0]["sigma_m"][2].is_null());
  EXPECT_FALSE(line["people"][0].contains("joints_raw"));
  EXPECT_EQ(line["dropped_before"], 0);
  EXPECT_EQ(json_of(frame_with(0), Level::pose)["people"], nlohmann::json::array());
}

TEST(WireJson, NumbersHaveFourDecimals) {
  PoseFrame frame = frame_with(1);
  frame.people[0].score = 0.93F;
  FrameEncoder encoder(kIds);
  EXPECT_NE(message_bytes(encoder, frame, Level::pose, Format::json, 0).find("\"score\":0.9300,"),
            std::string::npos);
}

TEST(WireJson, PresenceSaysNothingOfWhereAnybodyIs) {
  const nlohmann::json line = json_of(frame_with(2), Level::presence);
  EXPECT_EQ(line["people"], nlohmann::json::array());
  EXPECT_EQ(line["people_count"], 2);
  EXPECT_FALSE(line["quality"][0].contains("rssi_dbm"));
  const nlohmann::json person = json_of(frame_with(2), Level::position)["people"][0];
  EXPECT_EQ(person.size(), 3U) << person;
  EXPECT_TRUE(person.contains("id") && person.contains("score") && person.contains("root_m"));
}

/// What a person types wrong, and the code that comes back.
struct BadRequest {
  const char *line, *code, *mentions;
};
class Refused : public ::testing::TestWithParam<BadRequest> {};
INSTANTIATE_TEST_SUITE_P(
    Wire, Refused,
    ::testing::Values(
        BadRequest{"{", "bad_json", "JSON"}, BadRequest{"[]", "bad_json", "JSON"},
        BadRequest{"{}", "unknown_type", "subscribe"},
        BadRequest{R"({"type":"dance"})", "unknown_type", "unsubscribe"},
        BadRequest{R"({"type":7})", "unknown_type", "ping"},
        BadRequest{R"({"type":"subscribe"})", "bad_value", "what"},
        BadRequest{R"({"type":"subscribe","what":[]})", "bad_value", "what"},
        BadRequest{R"({"type":"subscribe","what":"pose"})", "bad_value", "list"},
        BadRequest{R"({"type":"subscribe","what":["topic_unspecified"]})", "bad_value", "what"},
        BadRequest{R"({"type":"subscribe","what":["pose"],"levle":"pose"})", "unknown_key", "levle"},
        BadRequest{R"({"type":"subscribe","what":["pose"],"level":"all"})", "bad_value", "presence"},
        BadRequest{R"({"type":"subscribe","what":["pose"],"max_hz":-1})", "bad_value", "max_hz"},
        BadRequest{R"({"type":"subscribe","what":["pose"],"max_hz":null})", "bad_value", "max_hz"},
        BadRequest{R"({"type":"subscribe","what":["pose"],"queue":4294967296})", "bad_value", "queue"},
        BadRequest{R"({"type":"subscribe","what":["pose"],"queue":-1})", "bad_value", "queue"},
        BadRequest{"{\"type\":\"ping\",\"id\":\"\xff\"}", "bad_json", "JSON"}));

TEST_P(Refused, WithCodeAndWords) {
  auto read = parse_client_message(Format::json, ByteView(std::string_view(GetParam().line)));
  ASSERT_FALSE(read.has_value());
  EXPECT_EQ(read.error().code, GetParam().code);
  EXPECT_NE((read.error().text + read.error().remedy).find(GetParam().mentions), std::string::npos)
      << read.error().text << " " << read.error().remedy;
}

TEST(WireProtobuf, RefusesWhatIsNoMessage) {
  const std::string bytes = "\x0a\xff\xff";
  EXPECT_EQ(parse_client_message(Format::protobuf, ByteView(bytes)).error().code, "bad_protobuf");
  EXPECT_EQ(parse_client_message(Format::protobuf, {}).error().code, "unknown_type");
  // subscribe { what: 9 }: an enum value from nowhere.
  const std::string unknown = {0x0a, 0x03, 0x0a, 0x01, 0x09};
  EXPECT_EQ(parse_client_message(Format::protobuf, ByteView(unknown)).error().code, "bad_value");
}

TEST(WireProtobuf, FrameWithThreeQuartersOfASkeletonIsRefused) {
  // pose { people { joints: [1.0] } }
  const std::string bytes = {0x22, 0x08, 0x62, 0x06, 0x1a, 0x04, 0, 0, '\x80', 0x3f};
  auto read = parse_server_message(Format::protobuf, ByteView(bytes));
  ASSERT_FALSE(read.has_value());
  EXPECT_EQ(read.error().code, "bad_message");
}

TEST(Wire, SchemaDescribesPoseFrame) {
  EXPECT_NE(pose_schema().find("PoseFrame"), std::string::npos);
  EXPECT_NE(pose_schema().find("csipose.v1"), std::string::npos);
}

TEST(Wire, NamesAreWords) {
  EXPECT_EQ(name_of(State::tracking), "tracking");
  EXPECT_EQ(name_of(static_cast<State>(99)), "unknown");
  EXPECT_EQ(names_of(reason_bit(Reason::rx_missing) | reason_bit(Reason::gap)), "rx_missing, gap");
}

}  // namespace
}  // namespace csipose
