// sim/truth_server.h - says where people really are to whoever connects to a Unix socket (proto/truth.h, docs/truth.md).
//
// Never waits for a reader: who is slow loses lines and is told how many.
#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include "proto/truth.h"
#include "proto/unix_socket.h"

namespace csipose::sim {

class TruthServer {
 public:
  /// Listens at `path`, mode 0660. Throws SetupError.
  TruthServer(const std::string& path, const TruthHello& hello);

  /// Readable when somebody wants to be let in.
  int descriptor() const { return listener_.get(); }
  /// Lets in who waits.
  void admit();
  void send(Truth truth);
  std::size_t readers() const { return readers_.size(); }

 private:
  struct Reader {
    FileDescriptor fd;
    std::string rest;  // of a line that has begun
    std::uint32_t lost = 0;
    bool gone = false;
  };
  void write(Reader& reader, const std::string& bytes);

  std::string hello_;
  FileDescriptor listener_;
  SocketFile file_;
  std::vector<Reader> readers_;
};

}  // namespace csipose::sim
