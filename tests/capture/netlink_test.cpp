#include "capture/netlink.h"

#include <gtest/gtest.h>
#include <linux/connector.h>
#include <linux/netlink.h>
#include <sys/socket.h>

#include "capture/netlink_source.h"
#include "tests/capture/bytes.h"

namespace csipose {
namespace {

using namespace testing;
constexpr ConnectorId kId = {26, 1};

Bytes message(const Bytes& data, ConnectorId id = kId) {
  nlmsghdr header{};
  header.nlmsg_len = static_cast<std::uint32_t>(36 + data.size());
  header.nlmsg_type = NLMSG_DONE;
  cn_msg body{};
  body.id.idx = id.idx;
  body.id.val = id.val;
  body.seq = 0xDEAD, body.ack = 0xBEEF, body.flags = 0xFFFF;  // uninitialised in the driver
  body.len = static_cast<std::uint16_t>(data.size());
  Bytes bytes;
  append(bytes, {&header, sizeof header});
  append(bytes, {&body, sizeof body});
  append(bytes, data);
  return bytes;
}

TEST(FindConnector, ReadsTheDriversLine) {
  EXPECT_EQ(find_connector(std::string("Name            ID\ncn_proc         1:1\niwlagn          26:1\n")),
            kId);
  EXPECT_EQ(find_connector(std::string("iwlagn 25:1")), (ConnectorId{25, 1}));
}

TEST(FindConnector, KnowsWhenTheDriverIsNotThere) {
  for (const char* text :
       {"", "\n", "Name            ID\ncn_proc         1:1\n", "iwlagn", "iwlagn ", "iwlagn x:1", "iwlagn 26",
        "iwlagn 26:", "iwlagn 26:1x", "iwlagnx 26:1", "iwlagn 0:1", "iwlagn 99999999999999999999:1"})
    EXPECT_FALSE(find_connector(std::string(text))) << text;
}

TEST(ConnectorMessage, GivesTheRecord) {
  const Bytes bytes = message({0xBB, 1, 2, 3});
  const auto record = parse_connector_message(bytes, kId);
  ASSERT_TRUE(record);
  EXPECT_EQ(copy(*record), (Bytes{0xBB, 1, 2, 3}));
}

TEST(ConnectorMessage, EachReason) {
  const Bytes whole = message({0xBB, 1, 2, 3});
  for (std::size_t size = 0; size < 36; ++size)
    EXPECT_EQ(parse_connector_message(ByteView(whole).sub(0, size), kId).error(),
              NetlinkFault::short_message);
  for (std::size_t size = 36; size < 40; ++size)
    EXPECT_EQ(parse_connector_message(ByteView(whole).sub(0, size), kId).error(), NetlinkFault::truncated);
  EXPECT_EQ(parse_connector_message(message({0xBB}, {25, 1}), kId).error(), NetlinkFault::foreign);
  EXPECT_EQ(parse_connector_message(message({0xBB}, {26, 2}), kId).error(), NetlinkFault::foreign);
  EXPECT_EQ(parse_connector_message(message({}), kId).error(), NetlinkFault::empty);
  EXPECT_STREQ(name(NetlinkFault::foreign), "netlink_foreign");
}

// Multicasts as the driver does. False: this user may not.
bool multicast(const Bytes& bytes) {
  const FileDescriptor socket(::socket(AF_NETLINK, SOCK_DGRAM, NETLINK_CONNECTOR));
  sockaddr_nl group{};
  group.nl_family = AF_NETLINK;
  group.nl_groups = 1u << (kId.idx - 1);
  return ::sendto(socket.get(), bytes.data(), bytes.size(), 0, reinterpret_cast<sockaddr*>(&group),
                  sizeof group) >= 0;
}

TEST(NetlinkSource, HearsTheKernelsMulticast) {
  std::unique_ptr<NetlinkSource> source;
  try {
    source = std::make_unique<NetlinkSource>(std::uint8_t{1}, kId);
  } catch (const SetupError& error) {
    GTEST_SKIP() << "left out: " << error.what();
  }
  if (!multicast(message({0xC1, 7}))) GTEST_SKIP() << "left out: multicasting on netlink needs CAP_NET_ADMIN";
  ASSERT_TRUE(multicast(message({0xBB, 9}, {26, 3})));  // of somebody else in our group
  ASSERT_TRUE(multicast(message({0xBB, 8})));
  ASSERT_TRUE(multicast(message(Bytes(17'000, 0xC1))));  // larger than any record
  ASSERT_TRUE(multicast(message({0xBB, 10})));
  Packet packet;
  ASSERT_EQ(source->poll(std::chrono::seconds(2), packet), SourceEvent::packet);
  EXPECT_EQ(packet.receiver, 1);
  EXPECT_EQ(copy(packet.records), (Bytes{0, 2, 0xC1, 7, 0, 2, 0xBB, 8}));
  ASSERT_EQ(source->poll(std::chrono::seconds(2), packet), SourceEvent::packet);
  EXPECT_EQ(copy(packet.records), (Bytes{0, 2, 0xBB, 10}));
  const SourceStats stats = source->stats();
  ASSERT_EQ(stats.refusals.size(), 2u);
  EXPECT_STREQ(stats.refusals[0].reason, "netlink_truncated");
  EXPECT_STREQ(stats.refusals[1].reason, "netlink_foreign");
}

TEST(NetlinkSource, CountsAnOverflowAndGoesOn) {
  std::unique_ptr<NetlinkSocket> socket;
  try {
    socket = std::make_unique<NetlinkSocket>(kId);
  } catch (const SetupError& error) {
    GTEST_SKIP() << "left out: " << error.what();
  }
  const int small = 1;  // the kernel makes it the least it allows
  setsockopt(socket->descriptor(), SOL_SOCKET, SO_RCVBUF, &small, sizeof small);
  int refused = 0;
  for (int i = 0; i < 100; ++i) refused += !multicast(message(Bytes(200, 0xBB)));
  if (refused == 100) GTEST_SKIP() << "left out: multicasting on netlink needs CAP_NET_ADMIN";
  while (!socket->take().empty()) {
  }
  EXPECT_EQ(socket->counts().overflows, 1u);
  EXPECT_GE(socket->counts().records, 1u);
  multicast(message({0xBB, 1}));
  EXPECT_EQ(copy(socket->take()), (Bytes{0, 2, 0xBB, 1}));
}

TEST(NetlinkSource, SaysWhatIsMissing) {
  try {
    csi_connector_of_this_host();
    GTEST_SKIP() << "left out: this host has the CSI driver";
  } catch (const SetupError& error) {
    EXPECT_EQ(error.status, ExitStatus::unavailable);
    const std::string words = error.what();
    EXPECT_TRUE(words.find("modprobe iwlwifi connector_log=0x5") != std::string::npos ||
                words.find("network namespace") != std::string::npos)
        << words;
  }
}

}  // namespace
}  // namespace csipose
