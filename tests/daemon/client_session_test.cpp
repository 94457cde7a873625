#include "daemon/client_session.h"

#include <gtest/gtest.h>

#include <nlohmann/json.hpp>

#include "tests/daemon/pose_frames.h"

namespace csipose {
namespace {

using std::chrono::milliseconds;
using testing::frame_with;

/// A session and what it says, without a socket; time is told.
class Session {
 public:
  explicit Session(StreamLimits limits = {}) : session(limits, "{\"type\":\"hello\"}\n", now) {}

  void say(const std::string& bytes) { session.receive(ByteView(bytes), now); }
  void ask(const std::string& line) { say(line + "\n"); }
  void offer(std::uint64_t seq, std::uint32_t people = 1) {
    session.offer(pool.take(frame_with(people, seq)));
  }

  /// Takes at most `limit` bytes.
  std::string take(std::size_t limit = SIZE_MAX) {
    std::string bytes;
    while (bytes.size() < limit && session.wants_output()) {
      const ClientSession::Parts parts = session.next_bytes();
      std::string message;
      for (const auto part : parts) message += part;
      message.resize(std::min(message.size(), limit - bytes.size()));
      if (message.empty()) break;
      session.sent(message.size(), now);
      bytes += message;
    }
    return bytes;
  }
  std::vector<nlohmann::json> lines() {
    std::vector<nlohmann::json> read;
    std::istringstream text(take());
    for (std::string line; std::getline(text, line);) read.push_back(nlohmann::json::parse(line));
    return read;
  }

  SteadyTime now{std::chrono::hours(1)};
  SharedFramePool pool{{"rx1", "rx2", "rx3"}};
  ClientSession session;
};

constexpr const char* kSubscribe = R"({"type":"subscribe","what":["pose"]})";

std::string subscribe(const std::string& more) {
  return R"({"type":"subscribe","what":["pose"],)" + more + "}";
}

TEST(ClientSession, SaysHelloBeforeItIsAsked) {
  Session s;
  EXPECT_EQ(s.take(), "{\"type\":\"hello\"}\n");
  EXPECT_FALSE(s.session.wants_output());
}

TEST(ClientSession, GrantsWhatIsAllowedAndNoMore) {
  StreamLimits limits;
  limits.max_level = Level::position;
  limits.queue_frames = 4;
  limits.pose_hz = 30;
  Session s(limits);
  s.ask(subscribe(R"("level":"raw","max_hz":100,"queue":50)"));
  auto granted = s.lines().at(1);
  EXPECT_EQ(granted["type"], "subscribed");
  EXPECT_EQ(granted["level"], "position");
  EXPECT_EQ(granted["max_hz"], 30);
  EXPECT_EQ(granted["queue"], 4);
  s.ask(subscribe(R"("level":"presence","max_hz":5,"queue":2,"on_full":"latest")"));
  granted = s.lines().at(0);
  EXPECT_EQ(granted["level"], "presence");
  EXPECT_EQ(granted["max_hz"], 5);
  EXPECT_EQ(granted["queue"], 1);
}

TEST(ClientSession, RawIsLoweredToPoseBecauseNoCsiIsStreamed) {
  StreamLimits limits;
  limits.max_level = Level::raw;
  Session s(limits);
  s.ask(subscribe(R"("level":"raw")"));
  EXPECT_EQ(s.lines().at(1)["level"], "pose");
}

TEST(ClientSession, WhoHasNotSubscribedIsGrantedNothing) {
  Session s;
  EXPECT_EQ(s.session.level(), Level::presence);
  s.ask(kSubscribe);
  s.ask(R"({"type":"unsubscribe"})");
  EXPECT_EQ(s.lines().back()["level"], "presence");
}

TEST(ClientSession, ALoweredMaximumHoldsForThoseWhoAreThere) {
  Session s;
  s.ask(kSubscribe);
  s.session.set_max_level(Level::presence);
  s.offer(1);
  EXPECT_EQ(s.lines().back()["people"], nlohmann::json::array());
}

TEST(ClientSession, SendsFramesInTurnOnceSubscribed) {
  Session s;
  s.offer(1);
  s.ask(kSubscribe);
  s.offer(2);
  s.offer(3);
  const auto lines = s.lines();
  ASSERT_EQ(lines.size(), 4U);
  EXPECT_EQ(lines[1]["type"], "subscribed");
  EXPECT_EQ(lines[2]["seq"], 2);
  EXPECT_EQ(lines[3]["seq"], 3);
  s.ask(R"({"type":"unsubscribe"})");
  s.offer(4);
  const auto after = s.lines();
  ASSERT_EQ(after.size(), 1U);
  EXPECT_EQ(after[0]["what"], nlohmann::json::array());
}

TEST(ClientSession, DropOldestTellsHowManyWereLostJustBefore) {
  Session s;
  s.ask(subscribe(R"("queue":3)"));
  s.take();
  for (std::uint64_t seq = 1; seq <= 10; ++seq) s.offer(seq);
  const auto lines = s.lines();
  ASSERT_EQ(lines.size(), 3U);
  EXPECT_EQ(lines[0]["seq"], 8);
  EXPECT_EQ(lines[0]["dropped_before"], 7);
  EXPECT_EQ(lines[1]["seq"], 9);
  EXPECT_EQ(lines[1]["dropped_before"], 0);
  EXPECT_EQ(s.session.frames_dropped(), 7U);
}

// What was not sent plus what was sent is what was offered, whatever the client's pace.
TEST(ClientSession, EveryFrameIsSentOrCounted) {
  Session s;
  s.ask(subscribe(R"("queue":2)"));
  s.take();
  std::uint64_t told = 0, got = 0, last = 0;
  std::string text;
  for (std::uint64_t seq = 1; seq <= 500; ++seq) {
    s.offer(seq);
    text += s.take((seq * 7919) % 2500);
  }
  text += s.take();
  std::istringstream stream(text);
  for (std::string line; std::getline(stream, line);) {
    const auto frame = nlohmann::json::parse(line);
    told += frame["dropped_before"].get<std::uint64_t>();
    ++got;
    EXPECT_EQ(frame["seq"].get<std::uint64_t>(), last + 1 + frame["dropped_before"].get<std::uint64_t>());
    last = frame["seq"];
  }
  EXPECT_EQ(last, 500U);
  EXPECT_EQ(told + got, 500U);
  EXPECT_EQ(told, s.session.frames_dropped());
  EXPECT_GT(told, 0U);
  EXPECT_EQ(got, s.session.frames_sent());
}

TEST(ClientSession, LatestKeepsOnlyTheNewest) {
  Session s;
  s.ask(subscribe(R"("on_full":"latest","queue":5)"));
  s.take();
  for (std::uint64_t seq = 1; seq <= 5; ++seq) s.offer(seq);
  const auto lines = s.lines();
  ASSERT_EQ(lines.size(), 1U);
  EXPECT_EQ(lines[0]["seq"], 5);
  EXPECT_EQ(lines[0]["dropped_before"], 4);
}

TEST(ClientSession, CloseEndsAnOverrunRecorder) {
  Session s;
  s.ask(subscribe(R"("on_full":"close","queue":2)"));
  s.take();
  for (std::uint64_t seq = 1; seq <= 3; ++seq) s.offer(seq);
  const auto lines = s.lines();
  ASSERT_EQ(lines.size(), 1U);
  EXPECT_EQ(lines[0]["type"], "bye");
  EXPECT_EQ(lines[0]["reason"], "overrun");
  EXPECT_TRUE(s.session.finished());
}

TEST(ClientSession, FramesLostBeforeItAreTold) {
  Session s;
  s.ask(kSubscribe);
  s.take();
  s.session.add_lost(5);
  s.offer(6);
  EXPECT_EQ(s.lines().at(0)["dropped_before"], 5);
}

TEST(ClientSession, MaxHzThinsEvenly) {
  Session s;
  s.ask(subscribe(R"("max_hz":10,"queue":8)"));
  s.take();
  std::vector<std::uint64_t> got;
  for (std::uint64_t seq = 0; seq < 90; ++seq) {  // 30 Hz
    s.offer(seq);
    for (const auto& line : s.lines()) got.push_back(line["seq"]);
  }
  ASSERT_EQ(got.size(), 30U);
  for (std::size_t i = 1; i < got.size(); ++i) EXPECT_EQ(got[i] - got[i - 1], 3U);
  EXPECT_EQ(s.session.frames_dropped(), 0U);
}

TEST(ClientSession, TheLeastMaxHzIsOneFrameADay) {
  Session s;
  s.ask(subscribe(R"("max_hz":1e-30,"queue":8)"));
  s.take();
  for (std::uint64_t seq = 0; seq < 90; ++seq) s.offer(seq);
  EXPECT_EQ(s.lines().size(), 1U);
}

TEST(ClientSession, OneByteAtATimeGivesTheSameMessages) {
  Session whole, bytewise;
  for (Session* s : {&whole, &bytewise}) {
    s->ask(kSubscribe);
    s->offer(1);
    s->offer(2);
  }
  std::string trickled;
  while (bytewise.session.wants_output()) trickled += bytewise.take(1);
  EXPECT_EQ(trickled, whole.take());
}

TEST(ClientSession, RequestsInPiecesAreTheSameRequests) {
  Session s;
  for (const char c : std::string(kSubscribe) + "\n{\"type\":\"ping\",\"id\":5}\n") s.say(std::string(1, c));
  const auto lines = s.lines();
  ASSERT_EQ(lines.size(), 3U);
  EXPECT_EQ(lines[1]["type"], "subscribed");
  EXPECT_EQ(lines[2]["type"], "pong");
  EXPECT_EQ(lines[2]["id"], 5);
}

TEST(ClientSession, ProtobufSpeaksProtobufAfterTheHello) {
  Session s;
  s.say(std::string(1, kProtobufMark) + encode(Format::protobuf, ClientMessage{Ping{77}}));
  const std::string out = s.take(), hello = "{\"type\":\"hello\"}\n";
  ASSERT_EQ(out.substr(0, hello.size()), hello);
  auto said = parse_server_message(Format::protobuf, ByteView(out).sub(hello.size() + 4));
  ASSERT_TRUE(said.has_value());
  EXPECT_EQ(std::get<Pong>(*said).id, 77U);
}

TEST(ClientSession, GarbageGetsWordsAndTheDoor) {
  Session s;
  s.say("GET / HTTP/1.1\r\n\r\n");
  const auto lines = s.lines();
  ASSERT_EQ(lines.size(), 3U);
  EXPECT_EQ(lines[1]["type"], "error");
  EXPECT_EQ(lines[1]["code"], "unknown_format");
  EXPECT_EQ(lines[2]["type"], "bye");
  EXPECT_TRUE(s.session.finished());
}

TEST(ClientSession, AWrongRequestIsAnsweredAndTheClientStays) {
  Session s;
  s.ask("{\"type\":\"dance\"}");
  s.ask("{nonsense");
  s.ask(kSubscribe);
  const auto lines = s.lines();
  ASSERT_EQ(lines.size(), 4U);
  EXPECT_EQ(lines[1]["code"], "unknown_type");
  EXPECT_EQ(lines[2]["code"], "bad_json");
  EXPECT_EQ(lines[3]["type"], "subscribed");
}

TEST(ClientSession, ARequestMayHave16KiBAndNoByteMore) {
  for (const bool too_long : {false, true}) {
    Session s;
    std::string line = R"({"type":"bye","reason":")";
    line += std::string(kMaxRequestBytes + (too_long ? 1 : 0) - line.size() - 2, 'x') + "\"}";
    s.ask(line);
    EXPECT_EQ(s.lines().at(1).value("code", "none"), too_long ? "too_long" : "none");
  }
  Session endless;
  for (int i = 0; i < 20; ++i) endless.say("{" + std::string(1023, ' '));
  EXPECT_EQ(endless.lines().at(1)["code"], "too_long");
  Session framed;
  framed.say(std::string(1, kProtobufMark) + std::string("\xff\xff\xff\x7f", 4));
  EXPECT_TRUE((framed.take(), framed.session.finished()));
}

TEST(ClientSession, TwentyRequestsASecond) {
  Session s;
  for (int i = 0; i < 25; ++i) s.ask("{\"type\":\"ping\"}");
  int pongs = 0, refused = 0;
  for (const auto& line : s.lines()) {
    pongs += line["type"] == "pong";
    refused += line["type"] == "error" && line["code"] == "too_many_requests";
  }
  EXPECT_EQ(pongs, 20);
  EXPECT_EQ(refused, 5);
  s.now += milliseconds(500);
  for (int i = 0; i < 25; ++i) s.ask("{\"type\":\"ping\"}");
  pongs = 0;
  for (const auto& line : s.lines()) pongs += line["type"] == "pong";
  EXPECT_EQ(pongs, 10);
}

TEST(ClientSession, WhoAsksAndNeverReadsIsClosed) {
  Session s;
  for (int i = 0; i < 100000 && !s.session.finished(); ++i) s.ask("{\"type\":\"ping\"}");
  EXPECT_TRUE(s.session.finished());
}

TEST(ClientSession, IsIdleOnlyWhileSomethingWaits) {
  Session s;
  s.take();
  s.now += std::chrono::minutes(5);
  EXPECT_FALSE(s.session.idle_too_long(s.now));
  s.ask(kSubscribe);
  s.now += std::chrono::seconds(9);
  EXPECT_FALSE(s.session.idle_too_long(s.now));
  s.now += std::chrono::seconds(2);
  EXPECT_TRUE(s.session.idle_too_long(s.now));
  s.take(1);
  EXPECT_FALSE(s.session.idle_too_long(s.now));
}

TEST(ClientSession, SaysByeAfterTheFramesThatWait) {
  Session s;
  s.ask(kSubscribe);
  s.offer(1);
  s.session.say_bye("stopped");
  s.offer(2);
  const auto lines = s.lines();
  ASSERT_EQ(lines.size(), 4U);
  EXPECT_EQ(lines[2]["seq"], 1);
  EXPECT_EQ(lines[3]["reason"], "stopped");
  EXPECT_TRUE(s.session.finished());
}

TEST(ClientSession, OnlyTheNewestStatusWaits) {
  Session s;
  s.ask(R"({"type":"subscribe","what":["status"]})");
  EXPECT_TRUE(s.session.take_status_request());
  EXPECT_FALSE(s.session.take_status_request());
  s.take();
  for (const char* text : {"{\"n\":1}\n", "{\"n\":2}\n"})
    s.session.offer_status(std::make_shared<const std::string>(text));
  EXPECT_EQ(s.take(), "{\"n\":2}\n");
}

TEST(SharedFrames, BytesAreMadeOnceAndUsedAgain) {
  SharedFramePool pool({"rx1", "rx2", "rx3"});
  const SharedFramePtr first = pool.take(frame_with(1, 1));
  const std::string* body = &first->body(Level::pose, Format::json);
  EXPECT_EQ(body, &first->body(Level::pose, Format::json));
  const SharedFramePtr second = pool.take(frame_with(1, 2));
  EXPECT_NE(first, second);
  const auto* released = second.get();
  SharedFramePtr third = (const_cast<SharedFramePtr&>(second).reset(), pool.take(frame_with(1, 3)));
  EXPECT_EQ(third.get(), released);
  EXPECT_NE(third->body(Level::pose, Format::json).find("\"seq\":3,"), std::string::npos);
}

}  // namespace
}  // namespace csipose
