#include "proto/sealed_sender.h"

#include <sys/socket.h>
#include <sys/timex.h>
#include <time.h>

#include <algorithm>
#include <array>
#include <cerrno>
#include <cstring>

#include "proto/record_stream.h"
#include "proto/result.h"
#include "proto/socket_address.h"

namespace csipose {
namespace {

constexpr int kAnswersAtOnce = 64;  // so that a flood of them keeps nothing else from being done

// Bound on the error of CLOCK_REALTIME as the kernel's clock discipline states it; 0 = not synchronised.
std::uint32_t utc_error_us() {
  timex state{};
  const int result = adjtimex(&state);
  if (result < 0 || result == TIME_ERROR || (state.status & STA_UNSYNC) != 0) return 0;
  return static_cast<std::uint32_t>(std::max(1L, state.maxerror));
}

std::int64_t utc_now_ns() {
  timespec now;
  clock_gettime(CLOCK_REALTIME, &now);
  return now.tv_sec * std::int64_t{1'000'000'000} + now.tv_nsec;
}

}  // namespace

FileDescriptor connect_to(const SocketAddress& address, int type) {
  FileDescriptor socket(::socket(address.family(), type | SOCK_CLOEXEC, 0));
  if (!socket || ::connect(socket.get(), address.get(), address.length) != 0)
    throw SetupError(ExitStatus::unavailable,
                     "cannot reach " + address.text() + ": " + std::strerror(errno) +
                         "; is csiposed running there, and this host on its network?");
  return socket;
}

SealedSender::SealedSender(const AgentKey& key, const std::string& host_and_port)
    : SealedSender(key, resolve(host_and_port, SOCK_DGRAM)) {}
SealedSender::SealedSender(const AgentKey& key, const SocketAddress& daemon)
    : socket_(connect_to(daemon, SOCK_DGRAM | SOCK_NONBLOCK)), session_(key) {}

void SealedSender::send(ByteView records, SteadyTime now) {
  const ByteView fitting = fit_datagram(records, omitted_);
  if (!fitting.empty()) put(session_.seal(fitting, now, time(now)));
}

void SealedSender::tend(SteadyTime now) {
  std::array<std::uint8_t, kMaxDatagram> buffer;
  for (int i = 0; i < kAnswersAtOnce; ++i) {
    const ssize_t size = ::recv(socket_.get(), buffer.data(), buffer.size(), 0);
    if (size < 0 && errno != ECONNREFUSED)
      break;  // that one tells of an earlier datagram that found no daemon
    if (size >= 0) session_.receive({buffer.data(), static_cast<std::size_t>(size)}, now);
  }
  put(session_.due(now, time(now)));
}

std::string SealedSender::status(SteadyTime now) const {
  const AgentSession::Counts& counts = session_.counts();
  std::uint64_t refused = 0;
  for (const std::uint64_t count : counts.refused) refused += count;
  return std::string(session_.connected(now) ? "connected" : "no answer from the daemon") +
         " sessions=" + std::to_string(counts.sessions) + " sent=" + std::to_string(counts.sealed) +
         " before_session=" + std::to_string(counts.no_session) + " not_sent=" + std::to_string(not_sent_) +
         " too_large=" + std::to_string(omitted_) + " lost_in_host=" + std::to_string(lost_in_host_) +
         " answers_refused=" + std::to_string(refused);
}

AgentTime SealedSender::time(SteadyTime now) {
  if (now >= error_known_until_) {
    error_us_ = utc_error_us();
    error_known_until_ = now + std::chrono::seconds(1);
  }
  return {static_cast<std::uint64_t>(ns(now)), utc_now_ns(), error_us_, omitted_ + lost_in_host_};
}

void SealedSender::put(ByteView datagram) {
  if (datagram.empty() || ::send(socket_.get(), datagram.data(), datagram.size(), 0) >= 0) return;
  // ECONNREFUSED tells of an earlier datagram that found no daemon; this one may.
  if (errno == ECONNREFUSED && ::send(socket_.get(), datagram.data(), datagram.size(), 0) >= 0) return;
  ++not_sent_;
}

ByteView fit_datagram(ByteView records, std::uint32_t& omitted) {
  if (records.size() <= kMaxRecords) return records;
  ++omitted;
  const std::size_t first = 2u + load_be16(records.data());
  if (records[2] != kFrameCode || first >= records.size()) return {};
  return fit_datagram(records.sub(first), omitted);
}

}  // namespace csipose
