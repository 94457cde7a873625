#include "daemon/publisher.h"

#include <gtest/gtest.h>
#include <sys/socket.h>
#include <sys/stat.h>

#include <filesystem>
#include <fstream>
#include <thread>

#include "daemon/stream_client.h"
#include "tests/daemon/pose_frames.h"
#include "tests/daemon/scratch_folder.h"

namespace csipose {
namespace {

using std::chrono::milliseconds;
using std::chrono::seconds;
using testing::frame_with;

PublisherConfig config_in(const testing::ScratchFolder& folder) {
  PublisherConfig config;
  config.socket_path = folder / "pose.sock";
  config.receiver_ids = {"rx1", "rx2", "rx3"};
  config.hello.name = "test";
  config.hello.session = 42;
  config.hello.source = Source::replay;
  return config;
}

PublisherLog silent() {
  return {[](const std::string&) {}, [](const std::string&) {}};
}

Subscription poses() {
  Subscription asked;
  asked.pose = true;
  return asked;
}

/// Waits with a deadline for what another thread does.
template <class Condition>
bool eventually(const Condition& holds) {
  const auto deadline = std::chrono::steady_clock::now() + seconds(10);
  while (!holds()) {
    if (std::chrono::steady_clock::now() > deadline) return false;
    std::this_thread::sleep_for(milliseconds(2));
  }
  return true;
}

std::optional<ReceivedPose> next_pose(StreamClient& client) {
  ServerMessage message;
  while (client.next(seconds(10), message) == StreamEvent::message)
    if (const auto* pose = std::get_if<ReceivedPose>(&message)) return *pose;
  return std::nullopt;
}

std::string next_bye(StreamClient& client) {
  ServerMessage message;
  while (client.next(seconds(10), message) == StreamEvent::message)
    if (const auto* bye = std::get_if<Bye>(&message)) return bye->reason;
  return "closed without bye";
}

TEST(Publisher, TwoFormatsGetTheSameFrames) {
  testing::ScratchFolder folder;
  PublisherConfig config = config_in(folder);
  config.limits.queue_frames = 64;
  Publisher publisher(config, silent());
  StreamClient json(config.socket_path, Format::json), protobuf(config.socket_path, Format::protobuf);
  EXPECT_EQ(json.hello().session, 42U);
  EXPECT_EQ(protobuf.hello().name, "test");
  json.subscribe(poses());
  protobuf.subscribe(poses());
  for (std::uint64_t seq = 1; seq <= 50; ++seq) publisher.publish(frame_with(seq % 4, seq));
  for (std::uint64_t seq = 1; seq <= 50; ++seq) {
    const auto a = next_pose(json), b = next_pose(protobuf);
    ASSERT_TRUE(a && b);
    ASSERT_EQ(a->frame.seq, seq);
    ASSERT_EQ(b->frame.seq, seq);
    EXPECT_EQ(a->frame.people_count, b->frame.people_count);
    EXPECT_EQ(a->frame.window_end, b->frame.window_end);
    for (std::size_t p = 0; p < a->frame.people_count; ++p)
      EXPECT_NEAR(a->frame.people[p].joints[9].z, b->frame.people[p].joints[9].z, 5.1e-5F);
  }
  publisher.finish("stopped");
  EXPECT_EQ(next_bye(json), "stopped");
  EXPECT_EQ(next_bye(protobuf), "stopped");
  EXPECT_FALSE(std::filesystem::exists(config.socket_path));
}

TEST(Publisher, CountsItsSubscribers) {
  testing::ScratchFolder folder;
  const PublisherConfig config = config_in(folder);
  Publisher publisher(config, silent());
  EXPECT_EQ(publisher.subscribers(), 0);
  {
    StreamClient client(config.socket_path, Format::protobuf);
    client.subscribe(poses());
    EXPECT_TRUE(eventually([&] { return publisher.subscribers() == 1; }));
  }
  EXPECT_TRUE(eventually([&] { return publisher.subscribers() == 0; }));
}

// A stranger, one who connects and says nothing, and one who never reads: the fourth must not notice.
TEST(Publisher, BadClientsDoNotDisturbTheGoodOne) {
  testing::ScratchFolder folder;
  PublisherConfig config = config_in(folder);
  config.limits.queue_frames = 4;
  Publisher publisher(config, silent());
  const FileDescriptor stranger = connect_unix(config.socket_path), mute = connect_unix(config.socket_path);
  StreamClient sleeper(config.socket_path, Format::json), good(config.socket_path, Format::protobuf);
  sleeper.subscribe(poses());
  good.subscribe(poses());
  const std::string garbage(100000, '\xee');
  send(stranger.get(), garbage.data(), garbage.size(), MSG_NOSIGNAL | MSG_DONTWAIT);
  for (std::uint64_t seq = 1; seq <= 300; ++seq) {
    publisher.publish(frame_with(5, seq));
    const auto pose = next_pose(good);
    ASSERT_TRUE(pose);
    ASSERT_EQ(pose->frame.seq, seq);
    ASSERT_EQ(pose->dropped_before, 0U);
  }
  publisher.set_status({});
  EXPECT_TRUE(eventually([&] { return publisher.status().client_dropped_frames > 0; }));
  const auto first_after = [&] {  // the sleeper wakes: what it lost is told, and adds up
    std::uint64_t seq = 0, told = 0, frames = 0;
    while (seq < 300) {
      const auto pose = next_pose(sleeper);
      if (!pose) break;
      seq = pose->frame.seq, told += pose->dropped_before, ++frames;
    }
    return told + frames;
  };
  EXPECT_EQ(first_after(), 300U);
}

TEST(Publisher, AClientThatTakesNothingIsClosed) {
  testing::ScratchFolder folder;
  PublisherConfig config = config_in(folder);
  config.limits.idle_close = milliseconds(200);
  Publisher publisher(config, silent());
  StreamClient sleeper(config.socket_path, Format::json);
  sleeper.subscribe(poses());
  ASSERT_TRUE(eventually([&] { return publisher.subscribers() == 1; }));
  std::uint64_t seq = 0;
  EXPECT_TRUE(eventually([&] {
    publisher.publish(frame_with(5, ++seq));
    return publisher.subscribers() == 0;
  }));
}

// One byte now and then keeps the socket's buffer full all the same: the client is closed, its memory was
// bounded.
TEST(Publisher, AClientThatReadsByteByByteLosesFramesAndNothingElse) {
  testing::ScratchFolder folder;
  PublisherConfig config = config_in(folder);
  config.limits.idle_close = milliseconds(300);
  Publisher publisher(config, silent());
  StreamClient trickle(config.socket_path, Format::json), good(config.socket_path, Format::protobuf);
  trickle.subscribe(poses());
  good.subscribe(poses());
  std::uint64_t seq = 0;
  EXPECT_TRUE(eventually([&] {
    char byte = 0;
    [[maybe_unused]] const ssize_t got = recv(trickle.fd(), &byte, 1, MSG_DONTWAIT);
    publisher.publish(frame_with(5, ++seq));
    const auto pose = next_pose(good);
    EXPECT_TRUE(pose && pose->frame.seq == seq);
    return publisher.subscribers() == 1;
  }));
}

TEST(Publisher, CloseOnFullSaysOverrun) {
  testing::ScratchFolder folder;
  const PublisherConfig config = config_in(folder);
  Publisher publisher(config, silent());
  StreamClient recorder(config.socket_path, Format::protobuf);
  Subscription asked = poses();
  asked.on_full = OnFull::close;
  recorder.subscribe(asked);
  for (std::uint64_t seq = 1; seq <= 64; ++seq) {
    publisher.publish(frame_with(5, seq));
    std::this_thread::yield();
  }
  std::uint64_t more = 64;
  ASSERT_TRUE(eventually([&] {
    publisher.publish(frame_with(5, ++more));
    publisher.set_status({});
    return publisher.status().client_dropped_frames > 0;
  }));
  EXPECT_EQ(next_bye(recorder), "overrun");
}

TEST(Publisher, LosslessGivesEveryFrameToTheSlowestOfTwo) {
  testing::ScratchFolder folder;
  PublisherConfig config = config_in(folder);
  config.lossless = true;
  config.ring_frames = 4;
  config.limits.queue_frames = 2;
  Publisher publisher(config, silent());
  StreamClient json(config.socket_path, Format::json), protobuf(config.socket_path, Format::protobuf);
  json.subscribe(poses());
  protobuf.subscribe(poses());
  ASSERT_TRUE(eventually([&] { return publisher.subscribers() == 2; }));
  constexpr std::uint64_t kFrames = 400;
  std::thread loop([&] {
    for (std::uint64_t seq = 1; seq <= kFrames; ++seq) publisher.publish(frame_with(3, seq));
    publisher.finish("end of recording", seconds(10));
  });
  std::thread fast([&] {
    for (std::uint64_t seq = 1; seq <= kFrames; ++seq) {
      const auto pose = next_pose(protobuf);
      ASSERT_TRUE(pose && pose->frame.seq == seq && pose->dropped_before == 0) << seq;
    }
    EXPECT_EQ(next_bye(protobuf), "end of recording");
  });
  for (std::uint64_t seq = 1; seq <= kFrames; ++seq) {
    if (seq % 40 == 0) std::this_thread::sleep_for(milliseconds(5));
    const auto pose = next_pose(json);
    ASSERT_TRUE(pose && pose->frame.seq == seq && pose->dropped_before == 0) << seq;
  }
  EXPECT_EQ(next_bye(json), "end of recording");
  fast.join();
  loop.join();
  EXPECT_EQ(publisher.ring_dropped(), 0U);
}

TEST(Publisher, LosslessDoesNotWaitForeverForOneWhoTakesNothing) {
  testing::ScratchFolder folder;
  PublisherConfig config = config_in(folder);
  config.lossless = true;
  config.ring_frames = 2;
  config.limits.idle_close = milliseconds(200);
  Publisher publisher(config, silent());
  StreamClient sleeper(config.socket_path, Format::json);
  sleeper.subscribe(poses());
  for (std::uint64_t seq = 1; seq <= 200; ++seq) publisher.publish(frame_with(5, seq));  // comes back
  EXPECT_TRUE(eventually([&] { return publisher.subscribers() == 0; }));
}

TEST(Publisher, FinishFreesALoopThatWaits) {
  testing::ScratchFolder folder;
  PublisherConfig config = config_in(folder);
  config.lossless = true;
  config.ring_frames = 2;
  Publisher publisher(config, silent());
  StreamClient sleeper(config.socket_path, Format::json);
  sleeper.subscribe(poses());
  std::atomic<std::uint64_t> published{0};
  std::thread loop([&] {
    for (std::uint64_t seq = 1; seq <= 500; ++seq) publisher.publish(frame_with(5, seq)), ++published;
  });
  publisher.finish("stopped", milliseconds(50));
  loop.join();
  EXPECT_EQ(published, 500U);
}

TEST(Publisher, AFullRingDropsAndTheClientIsTold) {
  testing::ScratchFolder folder;
  PublisherConfig config = config_in(folder);
  config.ring_frames = 2;
  Publisher publisher(config, silent());
  StreamClient client(config.socket_path, Format::protobuf);
  client.subscribe(poses());
  std::uint64_t seq = 0;
  ASSERT_TRUE(eventually([&] {
    for (int i = 0; i < 64; ++i) publisher.publish(frame_with(1, ++seq));
    return publisher.ring_dropped() > 0;
  }));
  ASSERT_TRUE(eventually([&] {  // one that gets through tells of those before it
    const std::uint64_t before = publisher.ring_dropped();
    publisher.publish(frame_with(1, ++seq));
    return publisher.ring_dropped() == before;
  }));
  std::thread reader([&] {
    std::uint64_t told = 0, got = 0, last = 0;
    while (const auto pose = next_pose(client)) told += pose->dropped_before, ++got, last = pose->frame.seq;
    EXPECT_EQ(told + got, last);
    EXPECT_GT(told, 0U);
  });
  publisher.finish("stopped", seconds(5));
  reader.join();
}

TEST(Publisher, StatusComesAtOnceAndThenWhenItIsSet) {
  testing::ScratchFolder folder;
  const PublisherConfig config = config_in(folder);
  Publisher publisher(config, silent());
  publisher.set_status(testing::busy_status());
  ASSERT_TRUE(eventually([&] { return publisher.status().name == "csipose"; }));
  StreamClient client(config.socket_path, Format::protobuf);
  Subscription asked;
  asked.status = true;
  client.subscribe(asked);
  ServerMessage message;
  ASSERT_EQ(client.next(seconds(10), message), StreamEvent::message);
  EXPECT_EQ(std::get<ReceivedStatus>(message).status.frames_published, 1234U);
  Status newer = testing::busy_status();
  newer.frames_published = 2000;
  publisher.set_status(newer);
  ASSERT_EQ(client.next(seconds(10), message), StreamEvent::message);
  const Status& got = std::get<ReceivedStatus>(message).status;
  EXPECT_EQ(got.frames_published, 2000U);
  ASSERT_EQ(got.clients.size(), 1U);
  EXPECT_NE(got.clients[0].name.find("protobuf"), std::string::npos);
}

TEST(Publisher, OneClientTooManyGetsWords) {
  testing::ScratchFolder folder;
  PublisherConfig config = config_in(folder);
  config.max_clients = 1;
  Publisher publisher(config, silent());
  const StreamClient first(config.socket_path, Format::json);
  try {
    const StreamClient second(config.socket_path, Format::json);
    FAIL() << "the second client was let in";
  } catch (const SetupError& error) {
    EXPECT_EQ(error.status, ExitStatus::try_again);
    EXPECT_NE(std::string(error.what()).find("max_clients"), std::string::npos) << error.what();
  }
}

TEST(Publisher, ReloadLowersTheLevelOfThoseWhoAreThere) {
  testing::ScratchFolder folder;
  PublisherConfig config = config_in(folder);
  Publisher publisher(config, silent());
  StreamClient client(config.socket_path, Format::json);
  EXPECT_EQ(client.subscribe(poses()).level, Level::pose);
  config.limits.max_level = Level::presence;
  publisher.configure(config.limits, 8);
  std::uint64_t seq = 0;
  EXPECT_TRUE(eventually([&] {
    publisher.publish(frame_with(2, ++seq));
    const auto pose = next_pose(client);
    return pose && pose->frame.people_count == 2 && pose->people_described == 0;
  }));
}

TEST(Publisher, SocketIsForOwnerAndGroup) {
  testing::ScratchFolder folder;
  const PublisherConfig config = config_in(folder);
  const Publisher publisher(config, silent());
  struct stat file {};
  ASSERT_EQ(stat(config.socket_path.c_str(), &file), 0);
  EXPECT_EQ(file.st_mode & 0777, 0660U);
}

TEST(Publisher, ASecondDaemonAtOneSocketIsRefusedAndAStaleSocketReplaced) {
  testing::ScratchFolder folder;
  const PublisherConfig config = config_in(folder);
  {
    const Publisher first(config, silent());
    EXPECT_THROW(Publisher(config, silent()), SetupError);
  }
  { const FileDescriptor stale = listen_unix(config.socket_path, ""); }  // its file stays behind
  EXPECT_TRUE(std::filesystem::exists(config.socket_path));
  const Publisher after(config, silent());
  EXPECT_EQ(StreamClient(config.socket_path, Format::json).hello().name, "test");
}

// A tool that waits for the file and then connects must never be told that nobody listens.
TEST(Publisher, WhoeverSeesTheSocketCanConnect) {
  testing::ScratchFolder folder;
  for (int round = 0; round < 200; ++round) {
    const std::string path = folder / ("s" + std::to_string(round));
    FileDescriptor listener;
    std::thread daemon([&] { listener = listen_unix(path, ""); });
    while (!std::filesystem::exists(path)) std::this_thread::yield();
    EXPECT_NO_THROW(connect_unix(path));
    daemon.join();
  }
}

TEST(Publisher, WhatIsNoSocketIsNotRemoved) {
  testing::ScratchFolder folder;
  const PublisherConfig config = config_in(folder);
  std::ofstream(config.socket_path) << "precious";
  EXPECT_THROW(Publisher(config, silent()), SetupError);
  EXPECT_TRUE(std::filesystem::exists(config.socket_path));
}

TEST(Publisher, SaysWhyAClientCannotConnect) {
  testing::ScratchFolder folder;
  try {
    const StreamClient client(folder / "nobody.sock", Format::json);
    FAIL();
  } catch (const SetupError& error) {
    EXPECT_EQ(error.status, ExitStatus::unavailable);
    EXPECT_NE(std::string(error.what()).find("not running"), std::string::npos) << error.what();
  }
}

}  // namespace
}  // namespace csipose
