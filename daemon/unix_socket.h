// daemon/unix_socket.h - Unix stream sockets: listening, connecting, and what the kernel tells of the other
// side.
#pragma once

#include <sys/types.h>

#include <string>
#include <utility>

namespace csipose {

/// Owns one file descriptor.
class UniqueFd {
 public:
  UniqueFd() = default;
  explicit UniqueFd(int fd) : fd_(fd) {}
  ~UniqueFd();
  UniqueFd(UniqueFd&& other) noexcept : fd_(std::exchange(other.fd_, -1)) {}
  UniqueFd& operator=(UniqueFd&& other) noexcept;
  int get() const { return fd_; }
  explicit operator bool() const { return fd_ >= 0; }

 private:
  int fd_ = -1;
};

/// A listening socket at `path`, mode 0660, of `group` when that is not empty; not blocking. A socket file
/// that nobody listens at is replaced. Throws SetupError: somebody listens there already, no such folder, no
/// right, no such group.
UniqueFd listen_unix(const std::string& path, const std::string& group);

/// A connected socket; blocking. Throws SetupError with words for the person who started a tool.
UniqueFd connect_unix(const std::string& path);

/// A socket file that goes when the listener goes.
class SocketFile {
 public:
  SocketFile() = default;
  explicit SocketFile(std::string path) : path_(std::move(path)) {}
  ~SocketFile();
  SocketFile(const SocketFile&) = delete;
  SocketFile& operator=(const SocketFile&) = delete;

 private:
  std::string path_;
};

/// Who is at the other end.
struct PeerCredentials {
  pid_t pid = 0;
  uid_t uid = 0;
};
PeerCredentials peer_of(int fd);

}  // namespace csipose
