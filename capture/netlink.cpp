#include "capture/netlink.h"

#include <fcntl.h>
#include <linux/connector.h>
#include <linux/netlink.h>
#include <sys/socket.h>

#include <algorithm>
#include <cerrno>
#include <cstdlib>
#include <cstring>

namespace csipose {
namespace {

constexpr std::size_t kHeaders = sizeof(nlmsghdr) + sizeof(cn_msg);
static_assert(kHeaders == 36, "the kernel's layout");
constexpr int kQueueBytes = 8 << 20;
constexpr int kMessagesPerTake = 64;
const char* const kConnectorFile = "/proc/net/connector";

[[noreturn]] void refuse(const std::string& what) {
  const int error = errno;
  const bool denied = error == EPERM || error == EACCES;
  throw SetupError(
      denied ? ExitStatus::no_permission : ExitStatus::os_refusal,
      what + ": " + std::strerror(error) +
          (denied ? "; this kernel wants CAP_NET_ADMIN for it: run as root or grant the capability" : ""));
}

FileDescriptor join(ConnectorId id) {
  FileDescriptor socket(::socket(AF_NETLINK, SOCK_DGRAM | SOCK_NONBLOCK | SOCK_CLOEXEC, NETLINK_CONNECTOR));
  if (!socket) refuse("no netlink connector socket");
  sockaddr_nl address{};
  address.nl_family = AF_NETLINK;  // pid 0: the kernel chooses, so several may listen
  if (::bind(socket.get(), reinterpret_cast<sockaddr*>(&address), sizeof address) != 0)
    refuse("cannot bind the netlink connector socket");
  const int group = static_cast<int>(id.idx);
  if (setsockopt(socket.get(), SOL_NETLINK, NETLINK_ADD_MEMBERSHIP, &group, sizeof group) != 0)
    refuse("cannot listen to the CSI driver (netlink group " + std::to_string(group) + ")");
  if (setsockopt(socket.get(), SOL_SOCKET, SO_RCVBUFFORCE, &kQueueBytes, sizeof kQueueBytes) != 0)
    setsockopt(socket.get(), SOL_SOCKET, SO_RCVBUF, &kQueueBytes,
               sizeof kQueueBytes);  // as much as is allowed
  return socket;
}

// "iwlagn          26:1" -> 26, 1
std::optional<ConnectorId> parse_line(const std::string& line) {
  static const std::string kName = "iwlagn";
  if (line.compare(0, kName.size(), kName) != 0) return std::nullopt;
  const char* const numbers = line.c_str() + kName.size();
  if (*numbers != ' ' && *numbers != '\t') return std::nullopt;
  char* end = nullptr;
  const unsigned long idx = std::strtoul(numbers, &end, 10);
  if (end == numbers || *end != ':') return std::nullopt;
  const char* const second = end + 1;
  const unsigned long val = std::strtoul(second, &end, 10);
  if (end == second || *end != '\0' || idx == 0 || idx > 0xFFFF || val > 0xFFFFFFFF) return std::nullopt;
  return ConnectorId{static_cast<std::uint32_t>(idx), static_cast<std::uint32_t>(val)};
}

}  // namespace

const char* name(NetlinkFault fault) {
  static constexpr std::array<const char*, kNetlinkFaults> kNames = {"netlink_truncated", "netlink_short",
                                                                     "netlink_foreign", "netlink_empty"};
  return kNames[static_cast<std::size_t>(fault)];
}

std::optional<ConnectorId> find_connector(ByteView text) {
  for (auto line = text.begin(); line < text.end();) {
    const auto end = std::find(line, text.end(), '\n');
    if (const auto id = parse_line(std::string(line, end))) return id;
    line = end + (end < text.end());
  }
  return std::nullopt;
}

ConnectorId csi_connector_of_this_host() {
  const FileDescriptor file(::open(kConnectorFile, O_RDONLY | O_CLOEXEC));
  if (!file)
    throw SetupError(
        ExitStatus::unavailable,
        std::string(kConnectorFile) +
            " is not there: the kernel has no connector, or this process runs in another network "
            "namespace, where CSI never arrives; run it in the host's own namespace");
  std::array<char, 4096> text;
  const ssize_t size = ::read(file.get(), text.data(), text.size());
  const auto id = find_connector({text.data(), static_cast<std::size_t>(std::max<ssize_t>(size, 0))});
  if (!id)
    throw SetupError(ExitStatus::unavailable, std::string("the CSI driver is not loaded: ") + kConnectorFile +
                                                  " has no line `iwlagn`; load the patched driver with "
                                                  "`modprobe iwlwifi connector_log=0x5`");
  return *id;
}

Result<ByteView, NetlinkFault> parse_connector_message(ByteView datagram, ConnectorId wanted) {
  if (datagram.size() < kHeaders) return NetlinkFault::short_message;
  cn_msg message;
  std::memcpy(&message, datagram.data() + sizeof(nlmsghdr), sizeof message);
  if (!(ConnectorId{message.id.idx, message.id.val} == wanted)) return NetlinkFault::foreign;
  if (message.len == 0) return NetlinkFault::empty;
  if (datagram.size() < kHeaders + message.len) return NetlinkFault::truncated;
  return datagram.sub(kHeaders, message.len);
}

NetlinkSocket::NetlinkSocket(ConnectorId id) : id_(id), socket_(join(id)) {}

ByteView NetlinkSocket::take() {
  for (int i = 0; i < kMessagesPerTake; ++i) {
    // MSG_TRUNC: the true size, even when the buffer was too small.
    const ssize_t size = ::recv(socket_.get(), buffer_.data(), buffer_.size(), MSG_TRUNC);
    if (size < 0 && errno == ENOBUFS) {  // said once per overflow; what was queued is still there
      ++counts_.overflows;
      continue;
    }
    if (size < 0) return {};
    const auto message = static_cast<std::size_t>(size) > buffer_.size()
                             ? Result<ByteView, NetlinkFault>(NetlinkFault::truncated)
                             : parse_connector_message({buffer_.data(), static_cast<std::size_t>(size)}, id_);
    if (!message) {
      ++counts_.faults[static_cast<std::size_t>(message.error())];
      continue;
    }
    ++counts_.records;
    // The record's length takes the place of cn_msg.flags, right before the data.
    std::uint8_t* const length = buffer_.data() + (kHeaders - 2);
    store_be16(length, static_cast<std::uint16_t>(message->size()));
    return {length, message->size() + 2};
  }
  return {};
}

}  // namespace csipose
