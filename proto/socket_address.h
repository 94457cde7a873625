// proto/socket_address.h - "127.0.0.1:8481", "[::1]:8481", "pi.lan:8481" as the system's socket functions
// want them. C++17-clean.
#pragma once

#include <sys/socket.h>

#include <string>

namespace csipose {

struct SocketAddress {
  sockaddr_storage storage{};
  socklen_t length = sizeof(sockaddr_storage);

  sockaddr* get() { return reinterpret_cast<sockaddr*>(&storage); }
  const sockaddr* get() const { return reinterpret_cast<const sockaddr*>(&storage); }
  int family() const { return storage.ss_family; }
  unsigned port() const;
  bool is_loopback() const;
  /// The same host, whatever the ports; an IPv4 address written as IPv6 (::ffff:a.b.c.d) is the IPv4 one.
  bool same_host(const SocketAddress& other) const;
  /// "127.0.0.1:8481", "[::1]:8481"
  std::string text() const;
};

/// HOST:PORT, with or without a scheme such as udp:// before it. Throws SetupError when it names nothing.
///   socket_type   SOCK_DGRAM or SOCK_STREAM
SocketAddress resolve(const std::string& host_and_port, int socket_type);

/// HOST alone (port 0), such as the peer that may connect.
SocketAddress resolve_host(const std::string& host);

/// The address that a socket is bound to: tells the port where 0 was asked for.
SocketAddress bound_address(int socket);

}  // namespace csipose
