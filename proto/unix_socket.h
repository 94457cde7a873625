// proto/unix_socket.h - Unix stream sockets: listening, connecting, and what the kernel tells of the other
// side.
#pragma once

#include <sys/types.h>

#include <string>

#include "proto/file_descriptor.h"

namespace csipose {

/// A listening socket at `path`, mode 0660, of `group` when that is not empty; not blocking. A socket file
/// that nobody listens at is replaced. Throws SetupError: somebody listens there already, no such folder, no
/// right, no such group.
FileDescriptor listen_unix(const std::string& path, const std::string& group);

/// Who should listen at a socket, in words for the person who started a tool, and what to do when nobody does.
struct UnixServer {
  std::string who = "the daemon", remedy = "Start csiposed, or name its socket with --socket.";
};
/// A connected socket; blocking. Throws SetupError.
FileDescriptor connect_unix(const std::string& path, const UnixServer& server = {});

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
