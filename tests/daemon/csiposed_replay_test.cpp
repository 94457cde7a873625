// csiposed as a process, on recordings: what subscribers get, twice the same, and how it ends.
#include <gtest/gtest.h>

#include <future>

#include "tests/daemon/daemon_fixture.h"

namespace csipose::testing {
namespace {

class Replay : public DaemonTest {
 protected:
  struct Both {
    Received json, protobuf;
    int status = -1;
  };
  /// One run of the daemon with two subscribers that are there from the first frame on.
  Both run_with_two_subscribers(std::vector<std::string> sets) const {
    sets.push_back("source.wait_clients=2");
    const auto daemon = start(sets);
    auto json = std::async(std::launch::async, [&] { return read_all(Format::json); });
    auto protobuf = std::async(std::launch::async, [&] { return read_all(Format::protobuf); });
    Both both{json.get(), protobuf.get(), daemon->wait()};
    if (both.status != 0) ADD_FAILURE() << daemon->log();
    return both;
  }
  /// Two runs, two formats; the frames of the first.
  std::vector<PoseFrame> expect_the_same_twice(const std::vector<std::string>& sets) const {
    const Both first = run_with_two_subscribers(sets), second = run_with_two_subscribers(sets);
    EXPECT_EQ(first.status, 0);
    EXPECT_EQ(first.json.raw, second.json.raw);
    EXPECT_EQ(first.protobuf.raw, second.protobuf.raw);
    EXPECT_EQ(first.json.frames.size(), first.protobuf.frames.size());
    EXPECT_NE(first.json.bye, "");
    EXPECT_NE(first.protobuf.bye, "");
    for (std::size_t i = 0; i < std::min(first.json.frames.size(), first.protobuf.frames.size()); ++i) {
      EXPECT_EQ(first.json.frames[i].seq, i + 1);
      EXPECT_EQ(first.json.frames[i].seq, first.protobuf.frames[i].seq);
      EXPECT_EQ(first.json.frames[i].state, first.protobuf.frames[i].state);
      EXPECT_EQ(first.json.frames[i].people_count, first.protobuf.frames[i].people_count);
    }
    for (const PoseFrame& frame : first.protobuf.frames) {
      EXPECT_EQ(frame.source, Source::replay);
      EXPECT_TRUE(frame.untrained);
      EXPECT_NE(frame.reasons & reason_bit(Reason::untrained), 0u);
    }
    return first.protobuf.frames;
  }
};

int count(const std::vector<PoseFrame>& frames, State state) {
  return static_cast<int>(
      std::count_if(frames.begin(), frames.end(), [=](const PoseFrame& f) { return f.state == state; }));
}

TEST_F(Replay, MadeUpRecordingsAreTheSameTwice) {
  const auto frames = expect_the_same_twice(replay_of(made_up_files(900)));
  EXPECT_NEAR(static_cast<double>(frames.size()), 90, 6);
  EXPECT_GT(count(frames, State::tracking), 80);
}

TEST_F(Replay, ARealRecordingGivenToThreeReceiversIsTheSameTwice) {
  CSIPOSE_NEEDS_SHARED_DATA();
  const std::string sample = shared_data("csi5300/sample_0x5_64_3000.dat").string();
  const auto frames = expect_the_same_twice(replay_of({sample, sample, sample}));
  EXPECT_NEAR(static_cast<double>(frames.size()), 3.0 * 30,
              6);  // 3 s; 1,000 packets a second onto a grid of 300
  EXPECT_GT(count(frames, State::tracking), 80);
}

TEST_F(Replay, TheSyncSetIsTheSameTwice) {
  CSIPOSE_NEEDS_SHARED_DATA();
  std::vector<std::string> files;
  for (const char* name : {"rx0", "rx1", "rx2"})
    files.push_back(shared_data(std::string("csi5300/sync/") + name + ".dat").string());
  const auto frames = expect_the_same_twice(replay_of(files));
  EXPECT_NEAR(static_cast<double>(frames.size()), 1.2 * 30, 6);
  EXPECT_GT(count(frames, State::tracking) + count(frames, State::degraded), 28);
}

TEST_F(Replay, OtherSettingsAreAnotherSession) {
  const auto files = made_up_files(300);
  auto sets = replay_of(files);
  const auto ten = run_with_two_subscribers(sets);
  sets.push_back("window.hop=5");
  const auto five = run_with_two_subscribers(sets);
  ASSERT_FALSE(ten.protobuf.frames.empty());
  ASSERT_FALSE(five.protobuf.frames.empty());
  EXPECT_NE(ten.protobuf.frames[0].session, five.protobuf.frames[0].session);
  EXPECT_GT(five.protobuf.frames.size(), ten.protobuf.frames.size() * 3 / 2);
}

TEST_F(Replay, WhatIsRecordedIsReplayedToTheSamePoses) {
  auto sets = replay_of(made_up_files(600));
  auto recording = sets;
  recording.push_back("record.enabled=true");
  const auto first = run_with_two_subscribers(recording);
  std::vector<std::string> files;
  for (const auto& entry : fs::directory_iterator(folder_ / "recordings"))
    files.push_back(entry.path().string());
  ASSERT_EQ(files.size(), 1u);
  const auto second = run_with_two_subscribers(replay_of(files));
  ASSERT_EQ(second.protobuf.frames.size(), first.protobuf.frames.size());
  for (std::size_t i = 0; i < first.protobuf.frames.size(); ++i) {
    const PoseFrame &a = first.protobuf.frames[i], &b = second.protobuf.frames[i];
    EXPECT_EQ(a.mono_ns, b.mono_ns);
    ASSERT_EQ(a.people_count, b.people_count);
    for (std::uint32_t p = 0; p < a.people_count; ++p)
      EXPECT_EQ(a.people[p].joints[0].x, b.people[p].joints[0].x);
  }
}

TEST_F(Replay, ARecordingCutAnywhereIsPlayedAsFarAsItGoes) {
  const auto files = made_up_files(300);
  for (const std::uintmax_t cut : {1u, 40u, 333u}) {
    for (const std::string& file : files) fs::resize_file(file, fs::file_size(file) - cut);
    const auto daemon = start(replay_of(files));
    EXPECT_EQ(daemon->wait(), 0) << daemon->log();
  }
}

TEST_F(Replay, SigtermSaysByeAndEndsSoon) {
  auto sets = replay_of(made_up_files(3000));
  sets.push_back("source.speed=1");
  const auto daemon = start(sets);
  auto reader = std::async(std::launch::async, [&] { return read_all(Format::json); });
  ASSERT_TRUE(eventually([&] { return daemon->has_said("ready"); })) << daemon->log();
  ASSERT_TRUE(eventually([&] { return daemon->has_said("client"); })) << daemon->log();
  daemon->send(SIGTERM);
  EXPECT_TRUE(eventually([&] { return !daemon->running(); }, std::chrono::seconds(10)));
  EXPECT_EQ(daemon->wait(), 0);
  EXPECT_EQ(reader.get().bye, "stopped");
  EXPECT_FALSE(fs::exists(socket()));
}

TEST_F(Replay, SigtermIsHeededWhileAClientTakesNothing) {
  auto sets = replay_of(made_up_files(9000));
  sets.insert(sets.end(), {"source.loop=true", "source.wait_clients=1", "stream.idle_close_s=3600"});
  const auto daemon = start(sets);
  const auto client = connect(Format::json);
  Subscription asked;
  asked.pose = true;
  client->subscribe(asked);  // and never reads: the replay, which may lose nothing, stands still
  ASSERT_TRUE(eventually([&] { return daemon->has_said("state is"); })) << daemon->log();
  daemon->send(SIGTERM);
  EXPECT_EQ(daemon->wait(), 0);
}

TEST_F(Replay, ReloadKeepsClientsAndSaysWhatNeedsARestart) {
  auto sets = replay_of(made_up_files(6000));
  sets.erase(sets.end() - 1);  // people.min_score is the file's
  sets.push_back("source.speed=1");
  write_config("[people]\nmin_score = 0.0\n");
  const auto daemon = start(sets);
  const auto client = connect(Format::protobuf);
  Subscription asked;
  asked.pose = true;
  client->subscribe(asked);
  const auto sees = [&](std::uint32_t people) {
    ServerMessage message;
    if (client->next(std::chrono::seconds(10), message) != StreamEvent::message) return false;
    const auto* pose = std::get_if<ReceivedPose>(&message);
    return pose != nullptr && pose->frame.state != State::warmup &&
           (pose->frame.people_count > 0) == (people > 0);
  };
  EXPECT_TRUE(eventually([&] { return sees(1); }));
  write_config("[people]\nmin_score = 1.0\n[window]\nhop = 5\n");
  daemon->send(SIGHUP);
  EXPECT_TRUE(eventually([&] { return sees(0); }));
  EXPECT_TRUE(daemon->has_said("window.hop = 5: needs restart, 10 stays")) << daemon->log();
  write_config("[people]\nmin_score = \"low\"\n");
  daemon->send(SIGHUP);
  EXPECT_TRUE(eventually([&] { return daemon->has_said("reload refused, the running configuration stays"); }))
      << daemon->log();
  EXPECT_TRUE(eventually([&] { return sees(0); }));
  daemon->send(SIGTERM);
  EXPECT_EQ(daemon->wait(), 0);
}

// ---- what a person can get wrong ----

TEST_F(Replay, ABadConfigurationIsRefusedWithItsPlace) {
  write_config("[window]\nhopp = 10\n");
  const auto daemon = start({});
  EXPECT_EQ(daemon->wait(), 78);
  EXPECT_TRUE(daemon->has_said("csiposed.toml:9:8: there is no key window.hopp; did you mean window.hop?"))
      << daemon->log();
}

TEST_F(Replay, AModelThatIsNotWholeIsRefused) {
  const auto sets = replay_of(made_up_files(30));
  fs::resize_file(folder_ / "micro.safetensors", fs::file_size(folder_ / "micro.safetensors") - 100);
  const auto daemon = start(sets);
  EXPECT_EQ(daemon->wait(), 65) << daemon->log();
  EXPECT_TRUE(daemon->has_said("micro.safetensors")) << daemon->log();
}

TEST_F(Replay, AModelThatIsNotThereIsNamed) {
  auto sets = replay_of(made_up_files(30));
  sets.push_back("model.path=" + (folder_ / "none.safetensors").string());
  const auto daemon = start(sets);
  EXPECT_EQ(daemon->wait(), 66) << daemon->log();
  EXPECT_TRUE(daemon->has_said("none.safetensors")) << daemon->log();
}

TEST_F(Replay, AModelForOtherWindowsIsRefused) {
  auto sets = replay_of(made_up_files(30));
  sets.push_back("window.sample_rate_hz=200");
  const auto daemon = start(sets);
  EXPECT_EQ(daemon->wait(), 78) << daemon->log();
  EXPECT_TRUE(daemon->has_said("window.sample_rate_hz")) << daemon->log();
}

TEST_F(Replay, AModelOfAnotherDigestIsRefused) {
  auto sets = replay_of(made_up_files(30));
  sets.push_back("model.sha256=" + std::string(64, '0'));
  const auto daemon = start(sets);
  EXPECT_EQ(daemon->wait(), 65) << daemon->log();
}

TEST_F(Replay, ARecordingThatIsNotThereIsNamed) {
  const auto daemon = start(replay_of({(folder_ / "none.dat").string()}));
  EXPECT_EQ(daemon->wait(), 66) << daemon->log();
  EXPECT_TRUE(daemon->has_said("none.dat")) << daemon->log();
}

TEST_F(Replay, ARunningDaemonsSocketIsNotTaken) {
  auto sets = replay_of(made_up_files(3000));
  sets.push_back("source.speed=1");
  const auto first = start(sets);
  ASSERT_TRUE(eventually([&] { return first->has_said("ready"); })) << first->log();
  const auto second = start(sets);
  EXPECT_NE(second->wait(), 0);
  first->send(SIGTERM);
  EXPECT_EQ(first->wait(), 0);
}

}  // namespace
}  // namespace csipose::testing
