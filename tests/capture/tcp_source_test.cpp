#include "capture/tcp_source.h"

#include <gtest/gtest.h>
#include <sys/socket.h>

#include <random>

#include "proto/result.h"
#include "tests/capture/dat_maker.h"

namespace csipose {
namespace {

using namespace testing;
using namespace std::chrono_literals;

TcpPeer peer(std::uint8_t receiver, const std::string& host = "127.0.0.1") {
  return {receiver, "127.0.0.1:0", host, true};
}

class Sender {
 public:
  explicit Sender(const SocketAddress& to, const char* from = nullptr)
      : socket_(::socket(AF_INET, SOCK_STREAM, 0)) {
    if (from != nullptr) {
      const SocketAddress own = resolve(std::string(from) + ":0", SOCK_STREAM);
      EXPECT_EQ(::bind(socket_.get(), own.get(), own.length), 0);
    }
    EXPECT_EQ(::connect(socket_.get(), to.get(), to.length), 0);
  }
  void send(const Bytes& bytes) {
    ASSERT_EQ(::send(socket_.get(), bytes.data(), bytes.size(), MSG_NOSIGNAL),
              static_cast<ssize_t>(bytes.size()));
  }
  // Whether the other side closes within a second.
  bool is_closed() {
    const timeval limit = {1, 0};
    setsockopt(socket_.get(), SOL_SOCKET, SO_RCVTIMEO, &limit, sizeof limit);
    char byte;
    const ssize_t size = ::recv(socket_.get(), &byte, 1, 0);
    return size == 0 || (size < 0 && errno == ECONNRESET);
  }

 private:
  FileDescriptor socket_;
};

Bytes pair_of(std::uint16_t n) {
  Bytes bytes = frame_record(n);
  append(bytes, csi_record(n * 1000u, n));
  return bytes;
}
std::vector<Bytes> take_all(TcpSource& source, Nanoseconds silence = 50ms) {
  std::vector<Bytes> all;
  Packet packet;
  while (source.poll(silence, packet) == SourceEvent::packet) all.push_back(copy(packet.records));
  return all;
}
std::uint64_t refusals(const TcpSource& source, const std::string& reason) {
  for (const auto& refusal : source.stats().refusals)
    if (refusal.reason == reason) return refusal.count;
  return 0;
}

TEST(TcpSource, ReadsRecordsHoweverTheyAreSplit) {
  TcpSource source({peer(2)});
  Sender sender(source.address(2));
  Bytes stream;
  for (std::uint16_t n = 0; n < 300; ++n) append(stream, pair_of(n));
  std::mt19937 random(1);
  std::vector<Bytes> all;
  for (std::size_t at = 0; at < stream.size();) {
    const std::size_t size = std::min<std::size_t>(stream.size() - at, 1 + random() % 700);
    sender.send({stream.begin() + static_cast<std::ptrdiff_t>(at),
                 stream.begin() + static_cast<std::ptrdiff_t>(at + size)});
    at += size;
    for (const Bytes& records : take_all(source, 0ms)) all.push_back(records);
  }
  for (const Bytes& records : take_all(source)) all.push_back(records);
  ASSERT_EQ(all.size(), 300u);
  for (std::uint16_t n = 0; n < 300; ++n) EXPECT_EQ(all[n], pair_of(n));
  EXPECT_EQ(source.stats().receivers[2].packets, 300u);
  EXPECT_EQ(source.stats().receivers[2].sessions, 1u);
}

TEST(TcpSource, AFramingErrorClosesAndIsCounted) {
  TcpSource source({peer(0)});
  for (const Bytes& wrong : {Bytes{0, 0, 0, 0}, Bytes{0, 4, 0x77, 1, 2, 3, 0, 9, 0x78, 0}}) {
    Sender sender(source.address(0));
    sender.send(pair_of(1));
    sender.send(wrong);
    EXPECT_EQ(take_all(source).size(), 1u);
    EXPECT_TRUE(sender.is_closed());
  }
  EXPECT_EQ(refusals(source, "framing"), 2u);
}

TEST(TcpSource, OnlyConfiguredPeersMaySend) {
  TcpSource source({peer(0, "127.0.0.2")});
  Sender stranger(source.address(0)), known(source.address(0), "127.0.0.2");
  known.send(pair_of(1));
  EXPECT_EQ(take_all(source).size(), 1u);
  EXPECT_TRUE(stranger.is_closed());
  EXPECT_EQ(refusals(source, "unknown_peer"), 1u);
}

TEST(TcpSource, ANewConnectionReplacesTheOld) {
  TcpSource source({peer(0)});
  Sender first(source.address(0));
  first.send(pair_of(1));
  EXPECT_EQ(take_all(source).size(), 1u);
  Sender second(source.address(0));
  second.send(pair_of(2));
  EXPECT_EQ(take_all(source), std::vector<Bytes>{pair_of(2)});
  EXPECT_TRUE(first.is_closed());
  EXPECT_EQ(refusals(source, "connection_replaced"), 1u);
}

TEST(TcpSource, PeersOfOnePortAndOfSeveral) {
  std::vector<TcpPeer> peers = {peer(0, "127.0.0.2"), peer(1, "127.0.0.3"), peer(2)};
  TcpSource first({peers[0]});
  const std::string shared = first.address(0).text();  // a port that is free again in a moment
  first = TcpSource({peer(0)});
  peers[0].listen = peers[1].listen = shared;
  TcpSource source(peers);
  EXPECT_EQ(source.address(0).port(), source.address(1).port());
  EXPECT_NE(source.address(0).port(), source.address(2).port());
  Sender a(source.address(0), "127.0.0.2"), b(source.address(1), "127.0.0.3"), c(source.address(2));
  a.send(pair_of(1)), b.send(pair_of(2)), c.send(pair_of(3));
  std::array<Bytes, kReceivers> got;
  Packet packet;
  while (source.poll(100ms, packet) == SourceEvent::packet) got[packet.receiver] = copy(packet.records);
  EXPECT_EQ(got, (std::array<Bytes, kReceivers>{pair_of(1), pair_of(2), pair_of(3)}));
}

TEST(TcpSource, RefusesWithWords) {
  TcpPeer secure = peer(0);
  secure.insecure = false;
  try {
    TcpSource source({secure});
    FAIL() << "took clear text without being told to";
  } catch (const SetupError& error) {
    EXPECT_NE(std::string(error.what()).find("insecure = true"), std::string::npos);
  }
  TcpSource other({peer(0)});
  TcpPeer a = peer(0), b = peer(1);
  a.listen = b.listen = "127.0.0.1:39471";
  EXPECT_THROW(TcpSource({a, b}), SetupError) << "cannot be told apart";
  a.listen = other.address(0).text();
  EXPECT_THROW(TcpSource({a}), SetupError) << "port in use";
}

}  // namespace
}  // namespace csipose
