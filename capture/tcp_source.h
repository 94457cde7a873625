// capture/tcp_source.h - csitool's own network carrier: log_to_server connects and sends its log stream.
//
// Nothing in that stream proves who sends it or hides what it says; so every peer has to be named by address
// in the configuration, with `insecure = true` written beside it. One connection per receiver: a new one from
// the same peer replaces the old, which may be the other half of a host that lost power. A framing error
// means that the sender lies (TCP loses nothing): the connection is closed and counted.
#pragma once

#include <array>
#include <memory>
#include <string>
#include <vector>

#include "capture/csitool_stream.h"
#include "capture/live_source.h"
#include "proto/file_descriptor.h"
#include "proto/socket_address.h"

namespace csipose {

struct TcpPeer {
  std::uint8_t receiver = 0;
  std::string listen = "127.0.0.1:8090";  ///< csitool's default; peers may share one, or be told apart by it
  std::string peer = "127.0.0.1";         ///< address that may connect
  bool insecure = false;
};

class TcpSource final : public LiveSource {
 public:
  /// Throws SetupError when a peer is not marked insecure, two peers cannot be told apart, or a port cannot
  /// be had.
  explicit TcpSource(const std::vector<TcpPeer>& peers);

  int descriptor() const override { return epoll_.get(); }
  bool take(Packet& packet) override;
  Source kind() const override { return Source::live; }
  std::string describe() const override;
  SourceStats stats() const override;
  /// Where the receiver is to connect: tells the port when 0 was asked for.
  SocketAddress address(std::uint8_t receiver) const;

 private:
  struct Listener {
    FileDescriptor socket;
    SocketAddress address;
  };
  struct Peer {
    std::uint8_t receiver;
    std::size_t listener;
    SocketAddress host;
  };
  struct Connection {
    FileDescriptor socket;
    CsitoolStream stream;
    Now read_at{};
  };
  enum class Read { some, nothing_yet, over };

  std::size_t listener_for(const std::string& listen);
  void accept_all();
  void admit(FileDescriptor socket, const SocketAddress& from, std::size_t listener);
  bool take_from(std::uint8_t receiver, Packet& packet);
  bool take_buffered(std::uint8_t receiver, Packet& packet);
  static Read read_more(Connection& connection);

  FileDescriptor epoll_;
  std::vector<Listener> listeners_;
  std::vector<Peer> peers_;
  std::array<std::unique_ptr<Connection>, kReceivers> connections_;
  std::array<SourceStats::Receiver, kReceivers> counts_{};
  std::array<std::uint64_t, kReceivers> framing_errors_{}, replaced_{};
  std::uint64_t unknown_peers_ = 0;
  std::size_t turn_ = 0;
};

}  // namespace csipose
