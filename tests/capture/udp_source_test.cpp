// Agent and daemon on real sockets of the loopback; what they say is tested in tests/proto/datagram_test.cpp.
#include "capture/udp_source.h"

#include <gtest/gtest.h>
#include <sys/socket.h>

#include "proto/result.h"
#include "tests/capture/bytes.h"

namespace csipose {
namespace {

using namespace testing;
using namespace std::chrono_literals;

AgentKey make_key(const std::string& name, std::uint8_t fill, KeyKind kind = KeyKind::live) {
  AgentKey key{name, kind, {}};
  key.secret.fill(fill);
  return key;
}
UdpSourceConfig config_for(std::vector<ReceiverDoor::Entry> agents) {
  UdpSourceConfig config;
  config.listen = "udp://127.0.0.1:0";
  config.agents = std::move(agents);
  return config;
}

// An agent's socket, driven by hand.
class Agent {
 public:
  Agent(const AgentKey& key, const SocketAddress& to)
      : socket_(::socket(AF_INET, SOCK_DGRAM | SOCK_NONBLOCK, 0)), session_(key) {
    EXPECT_EQ(::connect(socket_.get(), to.get(), to.length), 0);
  }
  void send(ByteView bytes) {
    if (bytes.empty()) return;
    ASSERT_EQ(::send(socket_.get(), bytes.data(), bytes.size(), 0), static_cast<ssize_t>(bytes.size()));
  }
  void send_records(const Bytes& records) { send(session_.seal(records, now_on_both_clocks().steady, {})); }
  // Says HELLO, and lets the source answer, until welcome.
  void connect(PacketSource& source) {
    Packet packet;
    for (int i = 0; i < 100 && session_.session() == 0; ++i) {
      send(session_.due(now_on_both_clocks().steady, {}));
      source.poll(20ms, packet);
      std::array<std::uint8_t, kMaxDatagram> buffer;
      const ssize_t size = ::recv(socket_.get(), buffer.data(), buffer.size(), 0);
      if (size > 0)
        session_.receive({buffer.data(), static_cast<std::size_t>(size)}, now_on_both_clocks().steady);
    }
    ASSERT_NE(session_.session(), 0u);
  }

 private:
  FileDescriptor socket_;
  AgentSession session_;
};

TEST(UdpSource, GivesWhatAgentsSend) {
  UdpSource source(config_for({{0, make_key("rx1", 1)}, {2, make_key("rx3", 3)}}));
  Agent first(make_key("rx1", 1), source.address()), third(make_key("rx3", 3), source.address());
  first.connect(source);
  third.connect(source);
  const auto before = now_on_both_clocks();
  first.send_records({0, 2, 0xBB, 1});
  third.send_records({0, 2, 0xBB, 3});
  Packet packet;
  ASSERT_EQ(source.poll(1s, packet), SourceEvent::packet);
  EXPECT_EQ(packet.receiver, 0);
  EXPECT_EQ(copy(packet.records), (Bytes{0, 2, 0xBB, 1}));
  EXPECT_GE(packet.arrival + 1ms, before.steady);
  EXPECT_LE(packet.arrival, now_on_both_clocks().steady);
  ASSERT_EQ(source.poll(1s, packet), SourceEvent::packet);
  EXPECT_EQ(packet.receiver, 2);
  EXPECT_EQ(source.poll(1ms, packet), SourceEvent::nothing);
  EXPECT_EQ(source.stats().receivers[0].packets, 1u);
  EXPECT_EQ(source.stats().receivers[2].sessions, 1u);
  EXPECT_TRUE(source.stats().refusals.empty());
  EXPECT_EQ(source.kind(), Source::live);
}

TEST(UdpSource, GarbageIsCountedAndStarvesNobody) {
  UdpSource source(config_for({{0, make_key("rx1", 1)}}));
  Agent good(make_key("rx1", 1), source.address()), bad(make_key("rx1", 9), source.address());
  good.connect(source);
  for (int i = 0; i < 200; ++i) bad.send(Bytes(100, static_cast<std::uint8_t>(i)));
  good.send_records({0, 2, 0xBB, 1});
  Packet packet;
  ASSERT_EQ(source.poll(2s, packet), SourceEvent::packet);
  EXPECT_EQ(packet.receiver, 0);
  const SourceStats stats = source.stats();
  ASSERT_EQ(stats.refusals.size(), 1u);
  EXPECT_EQ(stats.refusals[0].receiver, -1);
  EXPECT_STREQ(stats.refusals[0].reason, "bad_magic");
  EXPECT_EQ(stats.refusals[0].count, 200u);
}

TEST(UdpSource, TakesAnInheritedSocket) {
  const SocketAddress any = resolve("127.0.0.1:0", SOCK_DGRAM);
  FileDescriptor socket(::socket(AF_INET, SOCK_DGRAM, 0));
  ASSERT_EQ(::bind(socket.get(), any.get(), any.length), 0);
  UdpSourceConfig config = config_for({{0, make_key("rx1", 1)}});
  config.inherited_socket = ::dup(socket.get());
  UdpSource source(config);
  EXPECT_EQ(source.address().port(), bound_address(socket.get()).port());
  Agent agent(make_key("rx1", 1), source.address());
  agent.connect(source);

  FileDescriptor stream(::socket(AF_INET, SOCK_STREAM, 0));
  config.inherited_socket = stream.get();
  EXPECT_THROW(UdpSource{config}, SetupError);
}

TEST(UdpSource, KindFollowsFromTheKeys) {
  EXPECT_EQ(UdpSource(config_for({{0, make_key("rx1", 1, KeyKind::simulated)}})).kind(), Source::simulated);
  EXPECT_THROW(UdpSource(config_for({{0, make_key("rx1", 1, KeyKind::simulated)}, {1, make_key("rx2", 2)}})),
               SetupError);
}

TEST(UdpSource, RefusesWithWords) {
  EXPECT_THROW(UdpSource(config_for({})), SetupError);
  UdpSourceConfig config = config_for({{0, make_key("rx1", 1)}});
  UdpSource first(config);
  config.listen = first.address().text();
  try {
    UdpSource second(config);
    FAIL() << "two daemons on one port";
  } catch (const SetupError& error) {
    EXPECT_NE(std::string(error.what()).find("another csiposed"), std::string::npos) << error.what();
  }
  for (const char* listen :
       {"", "nonsense", "127.0.0.1", "127.0.0.1:", ":1", "127.0.0.1:99999", "no.such.host.invalid:1"}) {
    config.listen = listen;
    EXPECT_THROW(UdpSource{config}, SetupError) << listen;
  }
}

TEST(LiveSources, GivesPacketsOfAllInTurn) {
  std::vector<std::unique_ptr<LiveSource>> both;
  both.push_back(std::make_unique<UdpSource>(config_for({{0, make_key("rx1", 1)}})));
  both.push_back(std::make_unique<UdpSource>(config_for({{1, make_key("rx2", 2)}})));
  const SocketAddress to1 = static_cast<UdpSource&>(*both[0]).address(),
                      to2 = static_cast<UdpSource&>(*both[1]).address();
  LiveSources sources(std::move(both));
  Agent first(make_key("rx1", 1), to1), second(make_key("rx2", 2), to2);
  first.connect(sources);
  second.connect(sources);
  for (int i = 0; i < 50; ++i) {
    first.send_records({0, 2, 0xBB, 1});
    second.send_records({0, 2, 0xBB, 2});
  }
  std::array<int, kReceivers> packets{};
  Packet packet;
  while (packets[0] + packets[1] < 100 && sources.poll(1s, packet) == SourceEvent::packet)
    ++packets[packet.receiver];
  EXPECT_EQ(packets, (std::array<int, kReceivers>{50, 50, 0}));
  EXPECT_EQ(sources.stats().receivers[1].packets, 50u);
}

TEST(LiveSources, DoesNotMixLiveAndSimulated) {
  std::vector<std::unique_ptr<LiveSource>> both;
  both.push_back(std::make_unique<UdpSource>(config_for({{0, make_key("rx1", 1)}})));
  both.push_back(std::make_unique<UdpSource>(config_for({{1, make_key("rx2", 2, KeyKind::simulated)}})));
  EXPECT_THROW(LiveSources{std::move(both)}, SetupError);
}

TEST(SocketAddress, KnowsHostsAndLoopback) {
  EXPECT_TRUE(resolve("udp://127.0.0.1:8481", SOCK_DGRAM).is_loopback());
  EXPECT_TRUE(resolve("[::1]:1", SOCK_STREAM).is_loopback());
  EXPECT_FALSE(resolve("0.0.0.0:1", SOCK_STREAM).is_loopback());
  EXPECT_FALSE(resolve("192.0.2.1:1", SOCK_STREAM).is_loopback());
  EXPECT_EQ(resolve("[::1]:17", SOCK_STREAM).text(), "[::1]:17");
  EXPECT_TRUE(resolve_host("192.0.2.1").same_host(resolve("[::ffff:192.0.2.1]:5", SOCK_STREAM)));
  EXPECT_FALSE(resolve_host("192.0.2.1").same_host(resolve_host("192.0.2.2")));
}

}  // namespace
}  // namespace csipose
