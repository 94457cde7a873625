// The tool's commands, as processes, on a publisher with known frames.
#include "daemon/watch.h"

#include <gtest/gtest.h>
#include <sys/wait.h>

#include <array>
#include <atomic>
#include <cstdio>
#include <nlohmann/json.hpp>
#include <thread>

#include "daemon/publisher.h"
#include "tests/daemon/pose_frames.h"
#include "tests/daemon/scratch_folder.h"

namespace csipose {
namespace {

struct Outcome {
  int status = -1;
  std::string out;
};

Outcome csipose(const std::string& arguments) {
  Outcome outcome;
  FILE* pipe = popen((CSIPOSE_BIN_DIR "/csipose " + arguments + " 2>&1").c_str(), "r");
  std::array<char, 4096> buffer;
  for (std::size_t n = 0; (n = fread(buffer.data(), 1, buffer.size(), pipe)) > 0;)
    outcome.out.append(buffer.data(), n);
  const int status = pclose(pipe);
  outcome.status = WIFEXITED(status) ? WEXITSTATUS(status) : -1;
  return outcome;
}

/// Publishes frames, two people each, until it is told to stop or has published `count`.
class Daemon {
 public:
  explicit Daemon(std::uint64_t count = UINT64_MAX) : publisher_(config(), {[](auto&) {}, [](auto&) {}}) {
    publisher_.set_status(testing::busy_status());
    thread_ = std::thread([this, count] {
      while (!stop_ && publisher_.subscribers() == 0) std::this_thread::yield();
      for (std::uint64_t seq = 1; seq <= count && !stop_; ++seq) {
        publisher_.publish(testing::frame_with(2, seq));
        std::this_thread::sleep_for(std::chrono::milliseconds(1));
      }
      if (!stop_) publisher_.finish("end of recording", std::chrono::seconds(5));
    });
  }
  ~Daemon() {
    stop_ = true;
    thread_.join();
  }
  std::string option() const { return " --socket " + folder_ / "pose.sock"; }

 private:
  PublisherConfig config() const {
    PublisherConfig config;
    config.socket_path = folder_ / "pose.sock";
    config.receiver_ids = {"rx1", "rx2", "rx3"};
    return config;
  }
  testing::ScratchFolder folder_;
  Publisher publisher_;
  std::atomic<bool> stop_{false};
  std::thread thread_;
};

TEST(Watch, TextHasALinePerFrame) {
  const Daemon daemon;
  const Outcome outcome = csipose("watch --quiet --frames 5" + daemon.option());
  EXPECT_EQ(outcome.status, 0) << outcome.out;
  EXPECT_EQ(std::count(outcome.out.begin(), outcome.out.end(), '\n'), 5);
  EXPECT_NE(outcome.out.find("UNTRAINED"), std::string::npos);
}

TEST(Watch, JsonlIsTheStreamItself) {
  const Daemon daemon;
  const Outcome outcome = csipose("watch --quiet --format jsonl --frames 3" + daemon.option());
  std::istringstream lines(outcome.out);
  int frames = 0;
  for (std::string line; std::getline(lines, line); ++frames)
    EXPECT_EQ(nlohmann::json::parse(line)["people_count"], 2);
  EXPECT_EQ(frames, 3);
}

TEST(Watch, EndsWithTheDaemonAndSaysSo) {
  const Daemon daemon(4);
  const Outcome outcome = csipose("watch" + daemon.option());
  EXPECT_EQ(outcome.status, 0) << outcome.out;
  EXPECT_NE(outcome.out.find("end of recording"), std::string::npos) << outcome.out;
}

TEST(Watch, FewerFramesThanAskedForIsAFailure) {
  const Daemon daemon(4);
  const Outcome outcome = csipose("watch --frames 50" + daemon.option());
  EXPECT_EQ(outcome.status, 1) << outcome.out;
  EXPECT_NE(outcome.out.find("50 frames were asked for"), std::string::npos) << outcome.out;
}

TEST(Watch, EndsAfterTheTimeGiven) {
  const Daemon daemon;
  EXPECT_EQ(csipose("watch --quiet --for 0.2" + daemon.option()).status, 0);
}

TEST(Status, IsForPeopleOrForPrograms) {
  const Daemon daemon;
  const Outcome words = csipose("status" + daemon.option());
  EXPECT_EQ(words.status, 0) << words.out;
  EXPECT_NE(words.out.find("1234 published"), std::string::npos) << words.out;
  EXPECT_NE(words.out.find("12 forged"), std::string::npos) << words.out;
  const Outcome json = csipose("status --json" + daemon.option());
  EXPECT_EQ(nlohmann::json::parse(json.out)["frames_published"], 1234);
}

TEST(Conclude, AStreamThatVanishesIsAFailure) {
  WatchOutcome outcome;
  outcome.vanished = true;
  EXPECT_THROW(conclude({}, outcome), SetupError);
  outcome.vanished = false;
  outcome.interrupted = true;
  WatchOptions options;
  options.frames = 10;
  EXPECT_NO_THROW(conclude(options, outcome));
}

}  // namespace
}  // namespace csipose
