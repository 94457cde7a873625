// The agent as a process against the daemon's source in this one, over loopback.
#include <gtest/gtest.h>
#include <signal.h>
#include <sys/wait.h>
#include <unistd.h>

#include <map>
#include <set>

#include "capture/agent/outlet.h"
#include "capture/tcp_source.h"
#include "capture/udp_source.h"
#include "proto/keys.h"
#include "proto/result.h"
#include "proto/sealed_sender.h"
#include "tests/capture/dat_maker.h"

namespace csipose {
namespace {

using namespace testing;
using namespace std::chrono_literals;

class Process {
 public:
  Process(std::vector<std::string> arguments, const std::string& stderr_file) {
    arguments.insert(arguments.begin(), std::string(CSIPOSE_BIN_DIR) + "/csipose-agent");
    std::vector<char*> argv;
    for (std::string& argument : arguments) argv.push_back(argument.data());
    argv.push_back(nullptr);
    pid_ = fork();
    if (pid_ == 0) {
      if (freopen(stderr_file.c_str(), "w", stderr) != nullptr) execv(argv[0], argv.data());
      _exit(127);
    }
  }
  ~Process() {
    if (pid_ > 0) kill(pid_, SIGKILL), wait();
  }
  void stop() { kill(pid_, SIGTERM); }
  int wait() {
    int status = 0;
    waitpid(std::exchange(pid_, -1), &status, 0);
    return WIFEXITED(status) ? WEXITSTATUS(status) : -WTERMSIG(status);
  }

 private:
  pid_t pid_ = -1;
};

class AgentProcess : public ::testing::Test {
 protected:
  AgentProcess() {
    create_agent_key(folder_.path("rx1.key"), "rx1", KeyKind::live);
    create_agent_key(folder_.path("rx2.key"), "rx2", KeyKind::live);
    for (std::uint16_t n = 0; n < 100; ++n) {
      append(log_, frame_record(n));
      append(log_, csi_record(1000u * n, n));
    }
    folder_.write("a.dat", log_);
  }
  UdpSourceConfig config(const std::string& listen = "127.0.0.1:0") const {
    UdpSourceConfig config;
    config.listen = listen;
    config.agents = {{0, load_agent_key(folder_.path("rx1.key"))},
                     {1, load_agent_key(folder_.path("rx2.key"))}};
    return config;
  }
  std::vector<std::string> arguments(const std::string& id, const std::string& to,
                                     std::vector<std::string> more) const {
    std::vector<std::string> all = {"--id", id, "--key", folder_.path(id + ".key"),
                                    "--to", to, "--dat", folder_.path("a.dat")};
    all.insert(all.end(), more.begin(), more.end());
    return all;
  }
  std::string said() const {
    std::ifstream file(folder_.path("stderr"));
    return {std::istreambuf_iterator<char>(file), {}};
  }
  // Packets until `most` have come or none does for two seconds.
  static std::vector<std::pair<int, Bytes>> take(PacketSource& source, std::size_t most) {
    std::vector<std::pair<int, Bytes>> all;
    Packet packet;
    while (all.size() < most && source.poll(2s, packet) == SourceEvent::packet)
      all.emplace_back(packet.receiver, copy(packet.records));
    return all;
  }
  static std::uint64_t counter(const Bytes& records) {
    return load_le<std::uint64_t>(records.data() + 3 + 24 + 8);
  }

  Folder folder_;
  Bytes log_;
};

TEST_F(AgentProcess, SendsAWholeFileUnchanged) {
  UdpSource source(config());
  Process agent(arguments("rx1", source.address().text(), {}), folder_.path("stderr"));
  Bytes received;
  for (const auto& [receiver, records] : take(source, 100)) {
    EXPECT_EQ(receiver, 0);
    append(received, records);
  }
  EXPECT_EQ(received, log_);
  EXPECT_EQ(agent.wait(), 0);
  EXPECT_NE(said().find("sent=100 "), std::string::npos) << said();
  EXPECT_EQ(source.stats().receivers[0].lost, 0u);
  EXPECT_TRUE(source.stats().refusals.empty());
}

TEST_F(AgentProcess, TwoLoopsAreInStepAndOneFindsItsPlaceAgain) {
  UdpSource source(config());
  Process first(arguments("rx1", source.address().text(), {"--loop", "--rate", "500"}),
                folder_.path("stderr"));
  auto second = std::make_unique<Process>(
      arguments("rx2", source.address().text(), {"--loop", "--rate", "500"}), folder_.path("stderr2"));
  const auto common = [&] {
    std::array<std::set<std::uint64_t>, 2> counters;
    for (const auto& [receiver, records] : take(source, 400)) counters[receiver].insert(counter(records));
    std::size_t both = 0;
    for (const std::uint64_t n : counters[0]) both += counters[1].count(n);
    return both;
  };
  common();  // both are under way after this
  EXPECT_GT(common(), 190u);
  second = std::make_unique<Process>(arguments("rx2", source.address().text(), {"--loop", "--rate", "500"}),
                                     folder_.path("stderr2"));
  common();
  EXPECT_GT(common(), 190u);
  EXPECT_EQ(source.stats().receivers[1].sessions, 2u);
  first.stop();
  EXPECT_EQ(first.wait(), 0);
}

TEST_F(AgentProcess, FindsADaemonThatWasRestarted) {
  auto source = std::make_unique<UdpSource>(config());
  const std::string address = source->address().text();
  Process agent(arguments("rx1", address, {"--loop", "--rate", "500"}), folder_.path("stderr"));
  EXPECT_EQ(take(*source, 100).size(), 100u);
  source.reset();
  source = std::make_unique<UdpSource>(config(address));
  EXPECT_EQ(take(*source, 100).size(), 100u);
}

TEST_F(AgentProcess, ReplacedKeyIsRefusedWithoutAnAnswer) {
  UdpSource source(config());
  std::filesystem::remove(folder_.path("rx1.key"));
  create_agent_key(folder_.path("rx1.key"), "rx1", KeyKind::live);
  Process agent(arguments("rx1", source.address().text(), {}), folder_.path("stderr"));
  Packet packet;
  EXPECT_EQ(source.poll(700ms, packet), SourceEvent::nothing);
  ASSERT_EQ(source.stats().refusals.size(), 1u);
  EXPECT_STREQ(source.stats().refusals[0].reason, "unknown_agent");
  agent.stop();
  EXPECT_EQ(agent.wait(), 0);
  EXPECT_NE(said().find("no answer from the daemon"), std::string::npos) << said();
}

TEST_F(AgentProcess, SpeaksCsitoolsTcp) {
  TcpSource source({{2, "127.0.0.1:0", "127.0.0.1", true}});
  Process agent({"--csitool-tcp", source.address(2).text(), "--dat", folder_.path("a.dat"), "--rate", "2000"},
                folder_.path("stderr"));
  const auto packets = take(source, 100);
  ASSERT_EQ(packets.size(), 100u);
  EXPECT_EQ(packets[99].first, 2);
  EXPECT_EQ(counter(packets[99].second), 99u);
  EXPECT_EQ(agent.wait(), 0);
}

TEST_F(AgentProcess, SetUpMistakesEndItWithWordsAndStatus) {
  const auto run = [&](std::vector<std::string> all, ExitStatus status, const std::string& words) {
    Process agent(std::move(all), folder_.path("stderr"));
    EXPECT_EQ(agent.wait(), static_cast<int>(status)) << said();
    EXPECT_NE(said().find(words), std::string::npos) << said();
  };
  const std::string key = folder_.path("rx1.key");
  run({}, ExitStatus::usage, "--id is missing");
  run({"--id", "rx2", "--key", key, "--to", "127.0.0.1:1"}, ExitStatus::bad_config, "is for receiver rx1");
  run({"--id", "rx1", "--key", key, "--to", "nowhere"}, ExitStatus::bad_config, "HOST:PORT");
  run({"--id", "rx1", "--key", key, "--to", "127.0.0.1:1", "--dat", "/absent.dat"}, ExitStatus::no_input,
      "/absent.dat");
  run({"--id", "rx1", "--key", "/absent.key", "--to", "127.0.0.1:1"}, ExitStatus::no_input,
      "csipose agent add");
  run({"--csitool-tcp", "127.0.0.1:1", "--dat", folder_.path("a.dat")}, ExitStatus::unavailable,
      "cannot reach");
}

TEST(FitDatagram, LeavesOutTheFrameFirst) {
  std::uint32_t omitted = 0;
  const auto record = [](std::uint8_t code, std::size_t size) {
    Bytes bytes(size);
    store_be16(bytes.data(), static_cast<std::uint16_t>(size - 2));
    bytes[2] = code;
    return bytes;
  };
  Bytes fits = record(0xC1, 800);
  append(fits, record(0xBB, kMaxRecords - 800));
  EXPECT_EQ(fit_datagram(fits, omitted).size(), kMaxRecords);
  EXPECT_EQ(omitted, 0u);
  Bytes large = record(0xC1, 1500);
  append(large, record(0xBB, 215));
  EXPECT_EQ(copy(fit_datagram(large, omitted)), record(0xBB, 215));
  EXPECT_EQ(omitted, 1u);
  EXPECT_TRUE(fit_datagram(record(0xBB, 2000), omitted).empty());
  EXPECT_TRUE(fit_datagram(record(0xC1, 2000), omitted).empty());
  EXPECT_EQ(omitted, 3u);
}

}  // namespace
}  // namespace csipose
