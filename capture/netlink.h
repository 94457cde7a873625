// capture/netlink.h - CSI records from the patched iwlwifi driver of this host, over the kernel's connector.
//
// One netlink datagram carries one record, in host byte order:
//
//   nlmsghdr 16: u32 length, u16 type = NLMSG_DONE, u16 flags, u32 seq, u32 pid
//   cn_msg   20: u32 idx, u32 val, u32 seq, u32 ack, u16 len, u16 flags
//   data     cn_msg.len bytes: code, body
//
// seq, ack and flags are uninitialised by the driver and not looked at. idx differs between kernels; the line
// `iwlagn` of /proc/net/connector names it. Source: linux-80211n-csitool,
// drivers/net/wireless/iwlwifi/dvm/connector.c, and <linux/connector.h>. C++17-clean.
#pragma once

#include <array>
#include <cstdint>
#include <optional>
#include <string>

#include "proto/bytes.h"
#include "proto/file_descriptor.h"
#include "proto/result.h"

namespace csipose {

struct ConnectorId {
  std::uint32_t idx = 0, val = 0;
  bool operator==(const ConnectorId& other) const { return idx == other.idx && val == other.val; }
};

/// Where the CSI driver speaks, from the text of /proc/net/connector; nullopt when the driver is not in it.
std::optional<ConnectorId> find_connector(ByteView proc_net_connector);

/// The same from the running system. Throws SetupError: driver not loaded, or another network namespace.
ConnectorId csi_connector_of_this_host();

/// Why a netlink datagram gave no record.
enum class NetlinkFault : std::uint8_t {
  truncated,      ///< larger than the buffer, or than itself says
  short_message,  ///< ends within the two headers
  foreign,        ///< of another connector
  empty,          ///< without a code
};
inline constexpr std::size_t kNetlinkFaults = 4;
const char* name(NetlinkFault fault);

/// The bytes of a netlink datagram that are the record: code and body, as they lie in `datagram`.
Result<ByteView, NetlinkFault> parse_connector_message(ByteView datagram, ConnectorId wanted);

class NetlinkSocket {
 public:
  struct Counts {
    std::uint64_t records = 0;
    std::uint64_t overflows = 0;  ///< times that the kernel's queue was full and an unknown number was lost
    std::array<std::uint64_t, kNetlinkFaults> faults{};
  };

  /// Joins the connector's group. Throws SetupError without the privilege.
  explicit NetlinkSocket(ConnectorId id);

  int descriptor() const { return socket_.get(); }
  /// One framed record (length, code, body) if there is one, valid until the next call; empty otherwise.
  /// Never waits.
  ByteView take();
  const Counts& counts() const { return counts_; }

 private:
  // The most that a connector message can hold, and its two headers.
  static constexpr std::size_t kBufferBytes = 16'384 + 36;

  ConnectorId id_;
  FileDescriptor socket_;
  Counts counts_;
  std::array<std::uint8_t, kBufferBytes> buffer_{};
};

}  // namespace csipose
