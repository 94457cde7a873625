#include "capture/agent/outlet.h"

#include <sys/socket.h>
#include <sys/timex.h>
#include <time.h>

#include <algorithm>
#include <array>
#include <cerrno>
#include <cstring>

#include "capture/file_descriptor.h"
#include "capture/socket_address.h"
#include "proto/record_stream.h"
#include "proto/result.h"

namespace csipose {
namespace {

constexpr int kAnswersAtOnce = 64;  // so that a flood of them keeps nothing else from being done

FileDescriptor connect_to(const SocketAddress& address, int type) {
  FileDescriptor socket(::socket(address.family(), type | SOCK_CLOEXEC, 0));
  if (!socket || ::connect(socket.get(), address.get(), address.length) != 0)
    throw SetupError(ExitStatus::unavailable,
                     "cannot reach " + address.text() + ": " + std::strerror(errno) +
                         "; is csiposed running there, and this host on its network?");
  return socket;
}

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

class SealedOutlet final : public Outlet {
 public:
  SealedOutlet(const AgentKey& key, const SocketAddress& daemon)
      : socket_(connect_to(daemon, SOCK_DGRAM | SOCK_NONBLOCK)), session_(key) {}

  int descriptor() const override { return socket_.get(); }
  bool ready(SteadyTime now) const override { return session_.connected(now); }
  void send(ByteView records, SteadyTime now) override {
    const ByteView fitting = fit_datagram(records, omitted_);
    if (!fitting.empty()) put(session_.seal(fitting, now, time(now)));
  }
  void tend(SteadyTime now) override {
    std::array<std::uint8_t, kMaxDatagram> buffer;
    for (int i = 0; i < kAnswersAtOnce; ++i) {
      const ssize_t size = ::recv(socket_.get(), buffer.data(), buffer.size(), 0);
      if (size < 0 && errno != ECONNREFUSED)
        break;  // that one tells of an earlier datagram that found no daemon
      if (size >= 0) session_.receive({buffer.data(), static_cast<std::size_t>(size)}, now);
    }
    put(session_.due(now, time(now)));
  }
  void lost_in_host(std::uint64_t records) override { lost_in_host_ = static_cast<std::uint32_t>(records); }
  std::string status(SteadyTime now) const override {
    const AgentSession::Counts& counts = session_.counts();
    std::uint64_t refused = 0;
    for (const std::uint64_t count : counts.refused) refused += count;
    return std::string(session_.connected(now) ? "connected" : "no answer from the daemon") +
           " sessions=" + std::to_string(counts.sessions) + " sent=" + std::to_string(counts.sealed) +
           " before_session=" + std::to_string(counts.no_session) + " not_sent=" + std::to_string(not_sent_) +
           " too_large=" + std::to_string(omitted_) + " lost_in_host=" + std::to_string(lost_in_host_) +
           " answers_refused=" + std::to_string(refused);
  }

 private:
  AgentTime time(SteadyTime now) {
    if (now >= error_known_until_) {
      error_us_ = utc_error_us();
      error_known_until_ = now + std::chrono::seconds(1);
    }
    return {static_cast<std::uint64_t>(ns(now)), utc_now_ns(), error_us_, omitted_ + lost_in_host_};
  }
  void put(ByteView datagram) {
    if (datagram.empty() || ::send(socket_.get(), datagram.data(), datagram.size(), 0) >= 0) return;
    // ECONNREFUSED tells of an earlier datagram that found no daemon; this one may.
    if (errno == ECONNREFUSED && ::send(socket_.get(), datagram.data(), datagram.size(), 0) >= 0) return;
    ++not_sent_;
  }

  FileDescriptor socket_;
  AgentSession session_;
  std::uint32_t omitted_ = 0, lost_in_host_ = 0, error_us_ = 0;
  std::uint64_t not_sent_ = 0;
  SteadyTime error_known_until_{};
};

class CsitoolOutlet final : public Outlet {
 public:
  explicit CsitoolOutlet(const SocketAddress& daemon) : socket_(connect_to(daemon, SOCK_STREAM)) {}

  int descriptor() const override { return socket_.get(); }
  bool ready(SteadyTime) const override { return true; }
  void send(ByteView records, SteadyTime) override {
    if (::send(socket_.get(), records.data(), records.size(), MSG_NOSIGNAL) !=
        static_cast<ssize_t>(records.size()))
      refuse();
    ++sent_;
  }
  void tend(SteadyTime) override {
    char byte;
    if (::recv(socket_.get(), &byte, 1, MSG_DONTWAIT) == 0) refuse();
  }
  void lost_in_host(std::uint64_t) override {}
  std::string status(SteadyTime) const override { return "csitool tcp sent=" + std::to_string(sent_); }

 private:
  [[noreturn]] static void refuse() {
    throw SetupError(ExitStatus::io, "the daemon has closed the TCP connection");
  }
  FileDescriptor socket_;
  std::uint64_t sent_ = 0;
};

}  // namespace

std::unique_ptr<Outlet> open_sealed_outlet(const AgentKey& key, const std::string& host_and_port) {
  return std::make_unique<SealedOutlet>(key, resolve(host_and_port, SOCK_DGRAM));
}
std::unique_ptr<Outlet> open_csitool_outlet(const std::string& host_and_port) {
  return std::make_unique<CsitoolOutlet>(resolve(host_and_port, SOCK_STREAM));
}

ByteView fit_datagram(ByteView records, std::uint32_t& omitted) {
  if (records.size() <= kMaxRecords) return records;
  ++omitted;
  const std::size_t first = 2u + load_be16(records.data());
  if (records[2] != kFrameCode || first >= records.size()) return {};
  return fit_datagram(records.sub(first), omitted);
}

}  // namespace csipose
