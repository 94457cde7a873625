#include "daemon/notify.h"

#include <fmt/format.h>
#include <sys/socket.h>
#include <sys/un.h>
#include <systemd/sd-daemon.h>
#include <time.h>

#include <filesystem>

namespace csipose {

void notify_ready() { sd_notify(0, "READY=1"); }
void notify_status(const std::string& text) { sd_notify(0, ("STATUS=" + text).c_str()); }
void notify_stopping() { sd_notify(0, "STOPPING=1"); }
void notify_watchdog() { sd_notify(0, "WATCHDOG=1"); }

void notify_reloading() {
  timespec now{};
  clock_gettime(CLOCK_MONOTONIC, &now);
  sd_notify(
      0, fmt::format("RELOADING=1\nMONOTONIC_USEC={}", now.tv_sec * 1'000'000 + now.tv_nsec / 1000).c_str());
}

namespace {

std::string kind_of(int socket) {
  if (sd_is_socket(socket, AF_INET, SOCK_DGRAM, -1) > 0 || sd_is_socket(socket, AF_INET6, SOCK_DGRAM, -1) > 0)
    return "udp";
  if (sd_is_socket(socket, AF_INET, SOCK_STREAM, 1) > 0 || sd_is_socket(socket, AF_INET6, SOCK_STREAM, 1) > 0)
    return "tcp";
  sockaddr_un address{};
  socklen_t length = sizeof address;
  if (sd_is_socket(socket, AF_UNIX, SOCK_STREAM, 1) <= 0 ||
      getsockname(socket, reinterpret_cast<sockaddr*>(&address), &length) != 0)
    return "";
  return std::filesystem::path(address.sun_path).filename();
}

}  // namespace

std::map<std::string, int> inherited_sockets() {
  std::map<std::string, int> sockets;
  const int count = sd_listen_fds(1);
  for (int i = 0; i < count; ++i) sockets[kind_of(SD_LISTEN_FDS_START + i)] = SD_LISTEN_FDS_START + i;
  return sockets;
}

}  // namespace csipose
