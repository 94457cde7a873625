// capture/udp_source.h - sealed datagrams of all agents on one UDP socket.
#pragma once

#include <array>
#include <vector>

#include "capture/live_source.h"
#include "proto/datagram.h"
#include "proto/file_descriptor.h"
#include "proto/socket_address.h"

namespace csipose {

struct UdpSourceConfig {
  std::string listen = "udp://127.0.0.1:8481";  ///< port 0 = any free one: see address()
  int inherited_socket = -1;                    ///< bound by systemd; `listen` is then not looked at
  std::vector<ReceiverDoor::Entry> agents;      ///< every receiver that may speak, with its key
  ReceiverDoor::Limits limits;
};

class UdpSource final : public LiveSource {
 public:
  /// Throws SetupError when there is no key, when live and simulated keys are mixed, or the socket cannot be
  /// had.
  explicit UdpSource(const UdpSourceConfig& config);

  int descriptor() const override { return socket_.get(); }
  bool take(Packet& packet) override;
  Source kind() const override { return kind_; }
  std::string describe() const override { return "udp " + address().text(); }
  SourceStats stats() const override;
  SocketAddress address() const { return bound_address(socket_.get()); }

 private:
  struct Datagram {
    ByteView bytes;
    SocketAddress from;
    Nanoseconds waited{};  // in the socket's queue, by the kernel's stamp
  };
  bool receive(Datagram& datagram);

  FileDescriptor socket_;
  ReceiverDoor door_;
  std::vector<std::uint8_t> receiver_of_entry_;
  Source kind_;
  std::array<std::uint64_t, kReceivers> packets_{};
  std::uint32_t overflow_ = 0;  // datagrams that the kernel dropped because our queue was full
  std::uint64_t unanswered_ = 0;
  std::array<std::uint8_t, kMaxDatagram + 1> buffer_{};
};

}  // namespace csipose
