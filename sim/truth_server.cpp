#include "sim/truth_server.h"

#include <sys/socket.h>

#include <algorithm>
#include <cerrno>
#include <utility>

namespace csipose::sim {

namespace {
constexpr std::size_t kMostReaders = 16;
}

TruthServer::TruthServer(const std::string& path, const TruthHello& hello)
    : hello_(encode(hello)), listener_(listen_unix(path, "")), file_(path) {}

void TruthServer::admit() {
  for (;;) {
    FileDescriptor fd(accept4(listener_.get(), nullptr, nullptr, SOCK_NONBLOCK | SOCK_CLOEXEC));
    if (!fd) return;
    if (readers_.size() == kMostReaders) continue;  // closed again at once
    readers_.push_back({std::move(fd), {}, 0, false});
    write(readers_.back(), hello_);
  }
}

void TruthServer::send(Truth truth) {
  std::string line;  // the same for all who have lost nothing
  for (Reader& reader : readers_) {
    write(reader, std::exchange(reader.rest, {}));
    if (!reader.rest.empty()) {
      ++reader.lost;
      continue;
    }
    if (line.empty() || truth.dropped_before != reader.lost) {
      truth.dropped_before = reader.lost;
      line = encode(truth);
    }
    reader.lost = 0;
    write(reader, line);
  }
  std::erase_if(readers_, [](const Reader& reader) { return reader.gone; });
}

void TruthServer::write(Reader& reader, const std::string& bytes) {
  if (bytes.empty() || reader.gone) return;
  const ssize_t sent = ::send(reader.fd.get(), bytes.data(), bytes.size(), MSG_NOSIGNAL);
  if (sent < 0 && errno != EAGAIN && errno != EINTR) reader.gone = true;
  reader.rest = bytes.substr(static_cast<std::size_t>(std::max<ssize_t>(sent, 0)));
}

}  // namespace csipose::sim
