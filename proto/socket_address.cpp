#include "proto/socket_address.h"

#include <arpa/inet.h>
#include <netdb.h>
#include <netinet/in.h>

#include <algorithm>
#include <cstring>

#include "proto/result.h"

namespace csipose {
namespace {

const sockaddr_in& v4(const SocketAddress& a) { return *reinterpret_cast<const sockaddr_in*>(&a.storage); }
const sockaddr_in6& v6(const SocketAddress& a) { return *reinterpret_cast<const sockaddr_in6*>(&a.storage); }

// Every address as 16 bytes: IPv4 as ::ffff:a.b.c.d.
in6_addr as_v6(const SocketAddress& a) {
  if (a.family() == AF_INET6) return v6(a).sin6_addr;
  in6_addr mapped{};
  mapped.s6_addr[10] = mapped.s6_addr[11] = 0xFF;
  std::memcpy(mapped.s6_addr + 12, &v4(a).sin_addr, 4);
  return mapped;
}

bool is_port(const std::string& text) {
  const bool digits = std::all_of(text.begin(), text.end(), [](char c) { return c >= '0' && c <= '9'; });
  return digits && !text.empty() && text.size() <= 5 && std::stoul(text) <= 65535;
}

SocketAddress look_up(const std::string& host, const std::string& port, int socket_type,
                      const std::string& given) {
  addrinfo hints{};
  hints.ai_socktype = socket_type;
  hints.ai_flags = AI_ADDRCONFIG;
  addrinfo* found = nullptr;
  const int error = getaddrinfo(host.c_str(), port.c_str(), &hints, &found);
  if (error != 0)
    throw SetupError(ExitStatus::bad_config,
                     "'" + given + "' names no address: " + gai_strerror(error) +
                         "; write HOST:PORT, for example 127.0.0.1:8481 or [::1]:8481");
  SocketAddress address;
  std::memcpy(&address.storage, found->ai_addr, found->ai_addrlen);
  address.length = found->ai_addrlen;
  freeaddrinfo(found);
  return address;
}

}  // namespace

unsigned SocketAddress::port() const {
  return ntohs(family() == AF_INET6 ? v6(*this).sin6_port : v4(*this).sin_port);
}

bool SocketAddress::is_loopback() const {
  const in6_addr address = as_v6(*this);
  if (IN6_IS_ADDR_V4MAPPED(&address)) return address.s6_addr[12] == 127;
  return IN6_IS_ADDR_LOOPBACK(&address);
}

bool SocketAddress::same_host(const SocketAddress& other) const {
  const in6_addr a = as_v6(*this), b = as_v6(other);
  return std::memcmp(&a, &b, sizeof a) == 0;
}

std::string SocketAddress::text() const {
  char host[INET6_ADDRSTRLEN] = "?";
  const bool is_v6 = family() == AF_INET6;
  const void* const bytes = is_v6 ? static_cast<const void*>(&v6(*this).sin6_addr) : &v4(*this).sin_addr;
  inet_ntop(family(), bytes, host, sizeof host);
  return (is_v6 ? "[" + std::string(host) + "]" : std::string(host)) + ":" + std::to_string(port());
}

SocketAddress resolve(const std::string& given, int socket_type) {
  const std::size_t scheme = given.find("://");
  const std::string rest = scheme == std::string::npos ? given : given.substr(scheme + 3);
  const std::size_t colon = rest.rfind(':');
  std::string host = rest.substr(0, colon);
  if (colon == std::string::npos || host.empty() || !is_port(rest.substr(colon + 1)))
    throw SetupError(ExitStatus::bad_config,
                     "'" + given + "' is not HOST:PORT; write for example 127.0.0.1:8481 or [::1]:8481");
  if (host.front() == '[' && host.back() == ']') host = host.substr(1, host.size() - 2);
  return look_up(host, rest.substr(colon + 1), socket_type, given);
}

SocketAddress resolve_host(const std::string& host) { return look_up(host, "0", SOCK_STREAM, host); }

SocketAddress bound_address(int socket) {
  SocketAddress address;
  getsockname(socket, address.get(), &address.length);
  return address;
}

}  // namespace csipose
