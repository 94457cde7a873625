#include "capture/tcp_source.h"

#include <netinet/in.h>
#include <sys/epoll.h>
#include <sys/socket.h>

#include <algorithm>
#include <cassert>
#include <cerrno>
#include <cstring>

#include "proto/result.h"

namespace csipose {
namespace {

[[noreturn]] void refuse(const std::string& what) {
  const int error = errno;
  throw SetupError(error == EACCES ? ExitStatus::no_permission : ExitStatus::os_refusal,
                   what + ": " + std::strerror(error));
}

void watch(int epoll, int socket) {
  epoll_event event{};
  event.events = EPOLLIN;
  if (epoll_ctl(epoll, EPOLL_CTL_ADD, socket, &event) != 0) refuse("cannot wait for csitool's TCP");
}

FileDescriptor listen_on(const SocketAddress& address) {
  FileDescriptor socket(::socket(address.family(), SOCK_STREAM | SOCK_NONBLOCK | SOCK_CLOEXEC, 0));
  const int on = 1;
  setsockopt(socket.get(), SOL_SOCKET, SO_REUSEADDR, &on, sizeof on);
  if (::bind(socket.get(), address.get(), address.length) != 0 || ::listen(socket.get(), 8) != 0)
    refuse("cannot listen on tcp " + address.text() + " for csitool's log_to_server");
  return socket;
}

}  // namespace

TcpSource::TcpSource(const std::vector<TcpPeer>& peers) : epoll_(epoll_create1(EPOLL_CLOEXEC)) {
  assert(!peers.empty());
  if (!epoll_) refuse("cannot wait for csitool's TCP");
  for (const TcpPeer& peer : peers) {
    if (!peer.insecure)
      throw SetupError(ExitStatus::bad_config,
                       "receiver " + std::to_string(peer.receiver + 1) +
                           " would send by csitool's TCP from " + peer.peer +
                           ", which anybody on the way can read and forge; use csipose-agent, or "
                           "write insecure = true beside its address");
    const Peer added = {peer.receiver, listener_for(peer.listen), resolve_host(peer.peer)};
    for (const Peer& other : peers_)
      if (other.receiver == added.receiver ||
          (other.listener == added.listener && other.host.same_host(added.host)))
        throw SetupError(ExitStatus::bad_config, "two receivers would send by csitool's TCP from " +
                                                     peer.peer + " to " + peer.listen +
                                                     " and cannot be told apart; give each its own port");
    peers_.push_back(added);
  }
}

std::size_t TcpSource::listener_for(const std::string& listen) {
  const SocketAddress wanted = resolve(listen, SOCK_STREAM);
  for (std::size_t i = 0; i < listeners_.size(); ++i)
    if (wanted.port() != 0 && listeners_[i].address.port() == wanted.port() &&
        listeners_[i].address.same_host(wanted))
      return i;
  FileDescriptor socket = listen_on(wanted);
  watch(epoll_.get(), socket.get());
  const SocketAddress bound = bound_address(socket.get());
  listeners_.push_back({std::move(socket), bound});
  return listeners_.size() - 1;
}

SocketAddress TcpSource::address(std::uint8_t receiver) const {
  const auto peer =
      std::find_if(peers_.begin(), peers_.end(), [&](const Peer& p) { return p.receiver == receiver; });
  assert(peer != peers_.end());
  return listeners_[peer->listener].address;
}

bool TcpSource::take(Packet& packet) {
  accept_all();
  for (std::size_t i = 0; i < kReceivers; ++i) {
    turn_ = (turn_ + 1) % kReceivers;
    if (connections_[turn_] && take_from(static_cast<std::uint8_t>(turn_), packet)) return true;
  }
  return false;
}

void TcpSource::accept_all() {
  for (std::size_t i = 0; i < listeners_.size(); ++i) {
    SocketAddress from;
    FileDescriptor socket(
        ::accept4(listeners_[i].socket.get(), from.get(), &from.length, SOCK_NONBLOCK | SOCK_CLOEXEC));
    if (socket) admit(std::move(socket), from, i);  // one per call: others are still readable
  }
}

void TcpSource::admit(FileDescriptor socket, const SocketAddress& from, std::size_t listener) {
  const auto peer = std::find_if(peers_.begin(), peers_.end(), [&](const Peer& p) {
    return p.listener == listener && p.host.same_host(from);
  });
  if (peer == peers_.end()) {
    ++unknown_peers_;
    return;
  }
  const int on = 1;
  setsockopt(socket.get(), SOL_SOCKET, SO_KEEPALIVE, &on, sizeof on);
  watch(epoll_.get(), socket.get());
  auto connection = std::make_unique<Connection>();
  connection->socket = std::move(socket);
  replaced_[peer->receiver] += connections_[peer->receiver] != nullptr;
  ++counts_[peer->receiver].sessions;
  connections_[peer->receiver] = std::move(connection);
}

bool TcpSource::take_from(std::uint8_t receiver, Packet& packet) {
  auto& connection = connections_[receiver];
  if (take_buffered(receiver, packet)) return true;
  const Read read = read_more(*connection);
  if (read == Read::some && take_buffered(receiver, packet)) return true;
  framing_errors_[receiver] += connection->stream.broken();
  if (read == Read::over || connection->stream.broken()) connection.reset();
  return false;
}

bool TcpSource::take_buffered(std::uint8_t receiver, Packet& packet) {
  Connection& connection = *connections_[receiver];
  const ByteView records = connection.stream.next();
  if (records.empty()) return false;
  ++counts_[receiver].packets;
  packet = {receiver, connection.read_at.steady, connection.read_at.utc, records};
  return true;
}

TcpSource::Read TcpSource::read_more(Connection& connection) {
  const CsitoolStream::Room room = connection.stream.room();
  const ssize_t size = ::recv(connection.socket.get(), room.data, room.size, 0);
  connection.read_at = now_on_both_clocks();
  if (size > 0) connection.stream.filled(static_cast<std::size_t>(size));
  if (size > 0) return Read::some;
  return size < 0 && (errno == EAGAIN || errno == EINTR) ? Read::nothing_yet : Read::over;
}

std::string TcpSource::describe() const {
  std::string all = "csitool tcp (insecure)";
  for (const Listener& listener : listeners_) all.append(1, ' ').append(listener.address.text());
  return all;
}

SourceStats TcpSource::stats() const {
  SourceStats stats;
  stats.receivers = counts_;
  for (int i = 0; i < static_cast<int>(kReceivers); ++i) {
    if (framing_errors_[i] > 0) stats.refusals.push_back({i, "framing", framing_errors_[i]});
    if (replaced_[i] > 0) stats.refusals.push_back({i, "connection_replaced", replaced_[i]});
  }
  if (unknown_peers_ > 0) stats.refusals.push_back({-1, "unknown_peer", unknown_peers_});
  return stats;
}

}  // namespace csipose
