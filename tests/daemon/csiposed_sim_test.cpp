// csiposed as a process, fed by the simulator through its UDP door; and the truth beside the poses.
#include <gtest/gtest.h>

#include "daemon/truth_client.h"
#include "tests/daemon/daemon_fixture.h"

namespace csipose::testing {
namespace {

using namespace std::chrono_literals;

class Simulated : public DaemonTest {
 protected:
  Simulated() {
    std::string receivers = "[people]\nmin_score = 0.0\n";
    for (const std::string& id : ids_) {
      create_agent_key(key(id), id, KeyKind::simulated);
      receivers += fmt::format("[[receiver]]\nid = \"{}\"\nkey_file = \"{}\"\n", id, key(id));
    }
    write_config(receivers);
  }
  std::string key(const std::string& id) const { return (folder_ / (id + ".key")).string(); }
  std::string keys() const { return fmt::format("{},{},{}", key("rx1"), key("rx2"), key("rx3")); }
  std::string truth_socket() const { return (folder_ / "truth.sock").string(); }

  /// A daemon at this address, by default a free port; its log names the port.
  std::unique_ptr<Program> start_daemon(const std::string& address = "127.0.0.1:0") {
    fs::remove(folder_ / "log");
    auto daemon = start({"ingest.listen=udp://" + address, "loop.budget_ms=200", "loop.jitter_ms=60"});
    EXPECT_TRUE(eventually([&] { return daemon->has_said("ready"); }, 60s)) << daemon->log();
    const std::string log = daemon->log();
    const auto at = log.find("127.0.0.1:");
    address_ = log.substr(at, log.find_first_not_of("0123456789.:", at) - at);
    return daemon;
  }
  std::unique_ptr<Program> start_simulator(const std::vector<std::string>& more) const {
    std::vector<std::string> arguments = {"live", "--to", address_, "--keys", keys(), "--rate", "100"};
    arguments.insert(arguments.end(), more.begin(), more.end());
    return std::make_unique<Program>("csipose-sim", arguments, folder_ / "sim.log");
  }
  /// What the simulator says at its end that receiver `id` has sent.
  static std::uint64_t sent_by(const Program& simulator, const std::string& id) {
    const std::string log = simulator.log();
    const auto line = log.rfind(id + ": ");
    return line == std::string::npos ? 0 : std::stoull(log.substr(log.find(" sent=", line) + 6));
  }
  /// Packets of each receiver as the daemon counts them, asked for anew.
  std::vector<std::uint64_t> packets() const {
    const auto client = connect(Format::protobuf);
    Subscription asked;
    asked.status = true;
    client->subscribe(asked);
    std::vector<std::uint64_t> counts;
    for (ServerMessage message; counts.empty() && client->next(5s, message) == StreamEvent::message;)
      if (const auto* status = std::get_if<ReceivedStatus>(&message))
        for (const ReceiverStatus& receiver : status->status.receivers) counts.push_back(receiver.packets);
    return counts;
  }

  const std::vector<std::string> ids_ = {"rx1", "rx2", "rx3"};
  std::string address_;
};

TEST_F(Simulated, TwoPeopleInAnOfficeComeThroughTheDoorAndTheirTruthBesideThem) {
  const auto daemon = start_daemon();
  const auto poses = connect(Format::protobuf);
  Subscription asked;
  asked.pose = true;
  poses->subscribe(asked);
  const auto simulator =
      start_simulator({"--scene", "office", "--people", "2", "--seconds", "2", "--truth", truth_socket()});
  ASSERT_TRUE(eventually([&] { return fs::exists(truth_socket()); })) << simulator->log();
  TruthClient truth(truth_socket());
  EXPECT_EQ(truth.hello()->scene, "office, 2 people: walk");
  EXPECT_EQ(truth.hello()->receivers_m.size(), 3U);

  int windows = 0, paired = 0;
  for (ServerMessage message; simulator->running();) {
    truth.drain();
    if (poses->next(20ms, message) != StreamEvent::message) continue;
    const auto* pose = std::get_if<ReceivedPose>(&message);
    if (pose == nullptr) continue;
    EXPECT_EQ(pose->frame.source, Source::simulated);
    if (pose->frame.window_end == UtcTime{}) continue;
    ++windows;
    truth.drain();
    const Truth* then =
        truth.at(pose->frame.window_start + (pose->frame.window_end - pose->frame.window_start) / 2);
    if (then == nullptr) continue;
    ++paired;
    EXPECT_EQ(then->people.size(), 2U);
  }
  EXPECT_EQ(simulator->wait(), 0) << simulator->log();
  EXPECT_GT(windows, 0);
  EXPECT_GT(paired, 0);
  EXPECT_FALSE(fs::exists(truth_socket())) << "nothing is left behind";

  ASSERT_TRUE(simulator->has_said("200 packets")) << simulator->log();
  for (std::size_t r = 0; r < ids_.size(); ++r)
    EXPECT_TRUE(eventually([&] { return packets().at(r) == sent_by(*simulator, ids_[r]); }))
        << ids_[r] << ": " << packets().at(r) << " of " << sent_by(*simulator, ids_[r]);
  daemon->send(SIGTERM);
  EXPECT_EQ(daemon->wait(), 0);
}

TEST_F(Simulated, FindsADaemonThatWasRestarted) {
  auto daemon = start_daemon();
  const auto simulator = start_simulator({"--scene", "empty", "--people", "0"});
  const auto heard = [&] { return packets().at(0) > 0; };
  EXPECT_TRUE(eventually(heard)) << simulator->log();
  daemon->send(SIGTERM);
  EXPECT_EQ(daemon->wait(), 0);
  fs::remove(socket());
  daemon = start_daemon(address_);
  EXPECT_TRUE(eventually(heard)) << simulator->log();
  simulator->send(SIGTERM);
  EXPECT_EQ(simulator->wait(), 0);
  EXPECT_TRUE(simulator->has_said("sessions=2")) << simulator->log();
}

TEST_F(Simulated, AReceiverThatIsSwitchedOffIsNeverHeard) {
  const auto daemon = start_daemon();
  const auto simulator =
      start_simulator({"--scene", "empty", "--people", "0", "--seconds", "1", "--silent", "2"});
  EXPECT_EQ(simulator->wait(), 0) << simulator->log();
  EXPECT_TRUE(simulator->has_said("rx2: switched off")) << simulator->log();
  for (const std::size_t r : {0U, 2U})
    EXPECT_TRUE(eventually([&] { return packets().at(r) == sent_by(*simulator, ids_[r]); })) << ids_[r];
  EXPECT_GT(packets().at(0), 0U);
  EXPECT_EQ(packets().at(1), 0U);
  daemon->send(SIGTERM);
  EXPECT_EQ(daemon->wait(), 0);
}

TEST_F(Simulated, AKeyThatWouldSayLiveIsRefused) {
  address_ = "127.0.0.1:9";
  fs::remove(key("rx2"));
  create_agent_key(key("rx2"), "rx2", KeyKind::live);
  const auto simulator = start_simulator({"--scene", "empty"});
  EXPECT_EQ(simulator->wait(), 78);
  EXPECT_TRUE(simulator->has_said("frames would say live of what is simulated")) << simulator->log();
}

}  // namespace
}  // namespace csipose::testing
