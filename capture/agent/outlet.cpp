#include "capture/agent/outlet.h"

#include <sys/socket.h>

#include "proto/result.h"
#include "proto/sealed_sender.h"
#include "proto/socket_address.h"

namespace csipose {
namespace {

class SealedOutlet final : public Outlet {
 public:
  SealedOutlet(const AgentKey& key, const std::string& daemon) : sender_(key, daemon) {}

  int descriptor() const override { return sender_.descriptor(); }
  bool ready(SteadyTime now) const override { return sender_.connected(now); }
  void send(ByteView records, SteadyTime now) override { sender_.send(records, now); }
  void tend(SteadyTime now) override { sender_.tend(now); }
  void lost_in_host(std::uint64_t records) override { sender_.lost_in_host(records); }
  std::string status(SteadyTime now) const override { return sender_.status(now); }

 private:
  SealedSender sender_;
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
  return std::make_unique<SealedOutlet>(key, host_and_port);
}
std::unique_ptr<Outlet> open_csitool_outlet(const std::string& host_and_port) {
  return std::make_unique<CsitoolOutlet>(resolve(host_and_port, SOCK_STREAM));
}

}  // namespace csipose
