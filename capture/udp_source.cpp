#include "capture/udp_source.h"

#include <fcntl.h>
#include <sys/socket.h>
#include <time.h>

#include <algorithm>
#include <cerrno>
#include <cstring>

#include "proto/result.h"

namespace csipose {
namespace {

constexpr int kQueueBytes =
    4 << 20;  // a second of three receivers at 3,000 datagrams each, with the kernel's overhead
constexpr int kDatagramsPerTake = 64;

[[noreturn]] void refuse(const std::string& what, const std::string& remedy) {
  const int error = errno;
  const ExitStatus status = error == EACCES ? ExitStatus::no_permission : ExitStatus::os_refusal;
  throw SetupError(status, what + ": " + std::strerror(error) + "; " + remedy);
}

FileDescriptor open_socket(const UdpSourceConfig& config) {
  if (config.inherited_socket >= 0) {
    int type = 0;
    socklen_t size = sizeof type;
    if (getsockopt(config.inherited_socket, SOL_SOCKET, SO_TYPE, &type, &size) != 0 || type != SOCK_DGRAM)
      throw SetupError(ExitStatus::bad_config,
                       "the socket handed over for receivers' datagrams is not a UDP socket; "
                       "see ListenDatagram= in csiposed.socket");
    fcntl(config.inherited_socket, F_SETFL, O_NONBLOCK);
    return FileDescriptor(config.inherited_socket);
  }
  const SocketAddress address = resolve(config.listen, SOCK_DGRAM);
  FileDescriptor socket(::socket(address.family(), SOCK_DGRAM | SOCK_NONBLOCK | SOCK_CLOEXEC, 0));
  if (!socket) refuse("no UDP socket for " + config.listen, "look at the limits of this process");
  if (::bind(socket.get(), address.get(), address.length) != 0)
    refuse("cannot listen on " + config.listen,
           "is another csiposed running, or is the address not of this host?");
  return socket;
}

void set_options(int socket) {
  const int on = 1;
  if (setsockopt(socket, SOL_SOCKET, SO_RCVBUFFORCE, &kQueueBytes, sizeof kQueueBytes) != 0)
    setsockopt(socket, SOL_SOCKET, SO_RCVBUF, &kQueueBytes, sizeof kQueueBytes);  // as much as is allowed
  setsockopt(socket, SOL_SOCKET, SO_TIMESTAMPNS, &on, sizeof on);
  setsockopt(socket, SOL_SOCKET, SO_RXQ_OVFL, &on, sizeof on);
}

static_assert(static_cast<int>(KeyKind::replay) == static_cast<int>(Source::replay) &&
              static_cast<int>(KeyKind::simulated) == static_cast<int>(Source::simulated));

Source kind_of(const std::vector<ReceiverDoor::Entry>& agents) {
  for (const auto& agent : agents)
    if (agent.key.kind != agents.front().key.kind)
      throw SetupError(ExitStatus::bad_config,
                       "the keys of " + agents.front().key.name + " and " + agent.key.name +
                           " are of different kinds: receivers are all live, all replayed or all simulated");
  return agents.empty() ? Source::live : static_cast<Source>(agents.front().key.kind);
}

// How long ago the kernel took the datagram in. Its stamp is UTC, which may step meanwhile: not believed
// beyond 1 s.
Nanoseconds time_since(const timespec& stamp) {
  timespec now;
  clock_gettime(CLOCK_REALTIME, &now);
  const Nanoseconds waited((now.tv_sec - stamp.tv_sec) * 1'000'000'000LL + (now.tv_nsec - stamp.tv_nsec));
  return waited < Nanoseconds::zero() || waited > std::chrono::seconds(1) ? Nanoseconds::zero() : waited;
}

}  // namespace

UdpSource::UdpSource(const UdpSourceConfig& config)
    : socket_(open_socket(config)), door_(config.agents, config.limits), kind_(kind_of(config.agents)) {
  set_options(socket_.get());
  for (const auto& agent : config.agents) receiver_of_entry_.push_back(agent.receiver);
}

bool UdpSource::receive(Datagram& datagram) {
  iovec part = {buffer_.data(), buffer_.size()};
  alignas(cmsghdr) std::array<char, 128> control;
  msghdr message{};
  message.msg_name = datagram.from.get();
  message.msg_namelen = sizeof(sockaddr_storage);
  message.msg_iov = &part;
  message.msg_iovlen = 1;
  message.msg_control = control.data();
  message.msg_controllen = control.size();
  const ssize_t size = ::recvmsg(socket_.get(), &message, 0);
  if (size < 0) return false;
  datagram.bytes = {buffer_.data(), static_cast<std::size_t>(size)};
  datagram.from.length = message.msg_namelen;
  for (cmsghdr* c = CMSG_FIRSTHDR(&message); c != nullptr; c = CMSG_NXTHDR(&message, c)) {
    if (c->cmsg_level != SOL_SOCKET) continue;
    if (c->cmsg_type == SO_RXQ_OVFL) std::memcpy(&overflow_, CMSG_DATA(c), sizeof overflow_);
    timespec stamp;
    if (c->cmsg_type == SCM_TIMESTAMPNS) {
      std::memcpy(&stamp, CMSG_DATA(c), sizeof stamp);
      datagram.waited = time_since(stamp);
    }
  }
  return true;
}

bool UdpSource::take(Packet& packet) {
  for (int i = 0; i < kDatagramsPerTake; ++i) {
    Datagram datagram;
    if (!receive(datagram)) return false;
    const Now now = now_on_both_clocks();
    const ReceiverDoor::Answer answer = door_.receive(datagram.bytes, now.steady);
    if (!answer.reply.empty() && ::sendto(socket_.get(), answer.reply.data(), answer.reply.size(), 0,
                                          datagram.from.get(), datagram.from.length) < 0)
      ++unanswered_;  // the agent says HELLO again
    if (answer.kind != ReceiverDoor::Kind::records) continue;
    ++packets_[answer.receiver];
    packet = {answer.receiver, now.steady - datagram.waited, now.utc - datagram.waited, answer.records};
    return true;
  }
  return false;
}

SourceStats UdpSource::stats() const {
  SourceStats stats;
  const auto add = [&](int receiver, const DatagramFaultCounts& counts) {
    for (std::size_t i = 0; i < kDatagramFaults; ++i)
      if (counts[i] > 0) stats.refusals.push_back({receiver, name(static_cast<DatagramFault>(i)), counts[i]});
  };
  for (std::size_t i = 0; i < receiver_of_entry_.size(); ++i) {
    const ReceiverDoor::Counts counts = door_.counts(i);
    SourceStats::Receiver& receiver = stats.receivers[receiver_of_entry_[i]];
    receiver.packets = packets_[receiver_of_entry_[i]];
    receiver.lost = counts.lost;
    receiver.omitted = counts.omitted;
    receiver.sessions = counts.sessions;
    if (counts.last.clock_error_us > 0) receiver.clock_error_s = counts.last.clock_error_us * 1e-6;
    add(receiver_of_entry_[i], counts.refused);
  }
  add(-1, door_.unattributed());
  if (overflow_ > 0) stats.refusals.push_back({-1, "queue_overflow", overflow_});
  if (unanswered_ > 0) stats.refusals.push_back({-1, "unanswered", unanswered_});
  return stats;
}

}  // namespace csipose
