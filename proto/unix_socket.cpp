#include "proto/unix_socket.h"

#include <fmt/format.h>
#include <grp.h>
#include <sys/socket.h>
#include <sys/stat.h>
#include <sys/un.h>
#include <unistd.h>

#include <cerrno>
#include <cstdio>
#include <cstring>
#include <filesystem>

#include "proto/result.h"

namespace csipose {
namespace {

constexpr mode_t kSocketMode = 0660;

sockaddr_un address_of(const std::string& path) {
  sockaddr_un address{};
  address.sun_family = AF_UNIX;
  if (path.empty() || path.size() >= sizeof address.sun_path)
    throw SetupError(ExitStatus::bad_config,
                     fmt::format("The socket path '{}' has {} bytes; a Unix socket's may have 1 to {}. "
                                 "Choose a shorter path (daemon.run_dir for csiposed).",
                                 path, path.size(), sizeof address.sun_path - 1));
  path.copy(address.sun_path, path.size());
  return address;
}

FileDescriptor stream_socket(int flags) {
  FileDescriptor fd(socket(AF_UNIX, SOCK_STREAM | SOCK_CLOEXEC | flags, 0));
  if (!fd)
    throw SetupError(ExitStatus::os_refusal,
                     fmt::format("No Unix socket can be made: {}.", std::strerror(errno)));
  return fd;
}

int connect_to(int fd, const std::string& path) {
  const sockaddr_un address = address_of(path);
  return connect(fd, reinterpret_cast<const sockaddr*>(&address), sizeof address);
}

/// A socket file that nobody listens at is in nobody's way: it will be replaced.
void check_free(const std::string& path) {
  std::error_code error;
  const auto status = std::filesystem::symlink_status(path, error);
  if (!std::filesystem::exists(status)) return;
  if (!std::filesystem::is_socket(status))
    throw SetupError(ExitStatus::cannot_create,
                     fmt::format("{} is there and is no socket. Move it away, or choose another path "
                                 "(daemon.run_dir for csiposed).",
                                 path));
  if (connect_to(stream_socket(SOCK_NONBLOCK).get(), path) == 0 || errno == EAGAIN)
    throw SetupError(ExitStatus::try_again, fmt::format("Another program listens at {} already. Stop it, or "
                                                        "choose another path (daemon.run_dir for csiposed).",
                                                        path));
}

void give_to_group(const std::string& path, const std::string& group) {
  if (group.empty()) return;
  const struct group* entry = getgrnam(group.c_str());
  if (entry == nullptr)
    throw SetupError(
        ExitStatus::bad_config,
        fmt::format("There is no group '{}' for {}. Create it: groupadd --system {}.", group, path, group));
  if (chown(path.c_str(), static_cast<uid_t>(-1), entry->gr_gid) != 0)
    throw SetupError(
        ExitStatus::no_permission,
        fmt::format("{} cannot be given to group '{}': {}. Run as root or as a member of the group.", path,
                    group, std::strerror(errno)));
}

std::string why_not_connected(const std::string& path, const std::string& who, int error) {
  if (error == ENOENT)
    return fmt::format("There is no {}: {} is not running, or listens elsewhere.", path, who);
  if (error == ECONNREFUSED) return fmt::format("Nobody listens at {}: {} has ended.", path, who);
  if (error == EACCES)
    return fmt::format("You have no right to {}: it is for members of its group (ls -l shows which).", path);
  return fmt::format("{} cannot be connected: {}.", path, std::strerror(error));
}

}  // namespace

FileDescriptor listen_unix(const std::string& path, const std::string& group) {
  check_free(path);
  // Made under another name and moved when it listens: whoever finds the file can connect.
  const std::string fresh = path + ".new";
  const sockaddr_un address = address_of(fresh);
  unlink(fresh.c_str());
  FileDescriptor fd = stream_socket(SOCK_NONBLOCK);
  fchmod(fd.get(), kSocketMode);  // before bind: there is no moment in which the file has another mode
  if (bind(fd.get(), reinterpret_cast<const sockaddr*>(&address), sizeof address) != 0)
    throw SetupError(errno == EACCES ? ExitStatus::no_permission : ExitStatus::cannot_create,
                     fmt::format("The socket {} cannot be made: {}. Its folder must be there and writable "
                                 "(daemon.run_dir for csiposed).",
                                 path, std::strerror(errno)));
  const SocketFile remains(fresh);    // nothing, once it has been moved
  chmod(fresh.c_str(), kSocketMode);  // a umask has taken the group's bits
  give_to_group(fresh, group);
  if (listen(fd.get(), SOMAXCONN) != 0 || rename(fresh.c_str(), path.c_str()) != 0)
    throw SetupError(ExitStatus::os_refusal,
                     fmt::format("{} cannot listen: {}.", path, std::strerror(errno)));
  return fd;
}

FileDescriptor connect_unix(const std::string& path, const UnixServer& server) {
  FileDescriptor fd = stream_socket(0);
  if (connect_to(fd.get(), path) != 0) {
    const int error = errno;
    throw SetupError(error == EACCES ? ExitStatus::no_permission : ExitStatus::unavailable,
                     why_not_connected(path, server.who, error) + ' ' + server.remedy);
  }
  return fd;
}

SocketFile::~SocketFile() {
  if (!path_.empty()) unlink(path_.c_str());
}

PeerCredentials peer_of(int fd) {
  ucred credentials{};
  socklen_t size = sizeof credentials;
  getsockopt(fd, SOL_SOCKET, SO_PEERCRED, &credentials, &size);
  return {credentials.pid, credentials.uid};
}

}  // namespace csipose
