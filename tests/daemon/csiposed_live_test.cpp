// csiposed as a process, fed by real agents over the loopback: a receiver that dies, all that die, wrong keys.
#include <gtest/gtest.h>

#include <atomic>
#include <map>
#include <mutex>

#include "proto/socket_address.h"
#include "tests/daemon/daemon_fixture.h"

namespace csipose::testing {
namespace {

using namespace std::chrono_literals;

/// Reads poses on a thread of its own; keeps them with the time of their coming.
class Watcher {
 public:
  explicit Watcher(std::unique_ptr<StreamClient> client)
      : client_(std::move(client)), thread_([this] { run(); }) {}
  ~Watcher() {
    stop_ = true;
    thread_.join();
  }
  PoseFrame last() const {
    const std::lock_guard lock(mutex_);
    return frames_.empty() ? PoseFrame{} : frames_.back();
  }
  std::vector<PoseFrame> all() const {
    const std::lock_guard lock(mutex_);
    return frames_;
  }
  bool sees(State state) const {
    return eventually([&] { return last().state == state; });
  }

 private:
  void run() {
    Subscription asked;
    asked.pose = true;
    client_->subscribe(asked);
    ServerMessage message;
    while (!stop_ && client_->next(50ms, message) != StreamEvent::closed) {
      const auto* pose = std::get_if<ReceivedPose>(&message);
      if (pose == nullptr) continue;
      const std::lock_guard lock(mutex_);
      if (frames_.empty() || frames_.back().seq != pose->frame.seq) frames_.push_back(pose->frame);
    }
  }
  std::unique_ptr<StreamClient> client_;
  mutable std::mutex mutex_;
  std::vector<PoseFrame> frames_;
  std::atomic<bool> stop_{false};
  std::thread thread_;
};

class Live : public DaemonTest {
 protected:
  Live() {
    for (const std::string& id : ids_) create_agent_key(key(id), id, KeyKind::live);
    made_up_files(900);
  }

  std::string key(const std::string& id) const { return (folder_ / (id + ".key")).string(); }

  /// A daemon on a free port; its log names the port.
  std::unique_ptr<Program> start_daemon() {
    std::string receivers = "[ingest]\nlisten = \"udp://127.0.0.1:0\"\n[people]\nmin_score = 0.0\n";
    for (const std::string& id : ids_)
      receivers += fmt::format("[[receiver]]\nid = \"{}\"\nkey_file = \"{}\"\n", id, key(id));
    write_config(receivers);
    auto daemon = start({"loop.budget_ms=200", "loop.jitter_ms=60"});
    EXPECT_TRUE(eventually([&] { return daemon->has_said("ready"); }, 60s)) << daemon->log();
    const std::string log = daemon->log();
    const auto at = log.find("127.0.0.1:");
    address_ = log.substr(at, log.find_first_not_of("0123456789.:", at) - at);
    return daemon;
  }
  std::unique_ptr<Program> start_agent(std::size_t receiver, const std::string& key_file = "") {
    const std::string& id = ids_[receiver];
    return std::make_unique<Program>(
        "csipose-agent",
        std::vector<std::string>{"--id", id, "--key", key_file.empty() ? key(id) : key_file, "--to", address_,
                                 "--dat", (folder_ / "rx1.dat").string(), "--rate", "300", "--loop"},
        folder_ / (id + ".log"));
  }

  const std::vector<std::string> ids_ = {"rx1", "rx2", "rx3"};
  std::string address_;
};

/// Time from `since` to the first frame after it for which `holds`; the largest value when there is none.
std::int64_t first_after_ns(const std::vector<PoseFrame>& frames, std::int64_t since,
                            const std::function<bool(const PoseFrame&)>& holds) {
  for (const PoseFrame& frame : frames)
    if (frame.mono_ns > since && holds(frame)) return frame.mono_ns - since;
  return INT64_MAX;
}
std::int64_t now_ns() { return std::chrono::steady_clock::now().time_since_epoch().count(); }

TEST_F(Live, AReceiverDiesThenAllThenTheyComeBack) {
  const auto daemon = start_daemon();
  std::vector<std::unique_ptr<Program>> agents;
  for (std::size_t r = 0; r < 3; ++r) agents.push_back(start_agent(r));
  Watcher watcher(connect(Format::protobuf));
  ASSERT_TRUE(watcher.sees(State::tracking)) << daemon->log();
  EXPECT_EQ(watcher.last().source, Source::live);

  // One dies: DEGRADED, and poses go on from the others.
  agents[1]->send(SIGKILL);
  const std::int64_t killed = now_ns();
  ASSERT_TRUE(watcher.sees(State::degraded)) << daemon->log();
  const auto degraded_with_people = [](const PoseFrame& frame) {
    return frame.state == State::degraded && (frame.reasons & reason_bit(Reason::rx_missing)) != 0 &&
           frame.people_count > 0;
  };
  ASSERT_TRUE(
      eventually([&] { return first_after_ns(watcher.all(), killed, degraded_with_people) < INT64_MAX; }));
  RecordProperty("degraded_after_ms",
                 static_cast<int>(first_after_ns(watcher.all(), killed, degraded_with_people) / 1'000'000));
  std::uint64_t with_people = 0;
  EXPECT_TRUE(eventually([&] { return (with_people += degraded_with_people(watcher.last())) > 10; }));

  // It comes back.
  agents[1] = start_agent(1);
  ASSERT_TRUE(watcher.sees(State::tracking)) << daemon->log();

  // All die: nobody is sent.
  for (const auto& agent : agents) agent->send(SIGKILL);
  const std::int64_t all_killed = now_ns();
  ASSERT_TRUE(watcher.sees(State::stale)) << daemon->log();
  const std::int64_t stale_at =
      all_killed + first_after_ns(watcher.all(), all_killed,
                                  [](const PoseFrame& frame) { return frame.state == State::stale; });
  ASSERT_TRUE(eventually([&] { return now_ns() > stale_at + 1'500'000'000; }));
  int stale = 0;
  for (const PoseFrame& frame : watcher.all()) {
    if (frame.mono_ns < stale_at) continue;
    EXPECT_EQ(frame.people_count, 0u);
    stale += frame.state == State::stale;
  }
  EXPECT_GE(stale, 2);

  // All come back, without a restart of the daemon.
  for (std::size_t r = 0; r < 3; ++r) agents[r] = start_agent(r);
  EXPECT_TRUE(watcher.sees(State::tracking)) << daemon->log();
  daemon->send(SIGTERM);
  EXPECT_EQ(daemon->wait(), 0);
}

TEST_F(Live, AWrongKeyIsCountedAndGivesNothing) {
  const auto daemon = start_daemon();
  fs::create_directory(folder_ / "other");
  create_agent_key((folder_ / "other/rx1.key").string(), "rx1", KeyKind::live);
  const auto forger = start_agent(0, (folder_ / "other/rx1.key").string());
  const auto client = connect(Format::json);
  Subscription asked;
  asked.status = true;
  client->subscribe(asked);
  const auto refused = [&] {
    ServerMessage message;
    if (client->next(2s, message) != StreamEvent::message) return false;
    const auto* got = std::get_if<ReceivedStatus>(&message);
    if (got == nullptr || got->status.auth_failures.empty()) return false;
    EXPECT_EQ(got->status.state, State::warmup);
    EXPECT_EQ(got->status.receivers.at(0).packets, 0u);
    return got->status.auth_failures[0].count > 0;
  };
  EXPECT_TRUE(eventually(refused)) << daemon->log();
  daemon->send(SIGTERM);
  EXPECT_EQ(daemon->wait(), 0);
}

TEST_F(Live, AKeyOfAnotherReceiverIsRefusedAtStart) {
  write_config(fmt::format(
      "[[receiver]]\nid = \"rx1\"\nkey_file = \"{0}\"\n[[receiver]]\nid = \"rx2\"\nkey_file = \"{0}\"\n"
      "[[receiver]]\nid = \"rx3\"\nkey_file = \"{1}\"\n",
      key("rx1"), key("rx3")));
  const auto daemon = start({});
  EXPECT_EQ(daemon->wait(), 78) << daemon->log();
  EXPECT_TRUE(daemon->has_said("belongs to rx1, but receiver rx2 names it")) << daemon->log();
}

}  // namespace
}  // namespace csipose::testing
