// daemon/stream_client.h - the other side of the pose socket, for the tool and the tests: connect, subscribe,
// read.
#pragma once

#include <optional>
#include <string>

#include "proto/time.h"
#include "proto/unix_socket.h"
#include "proto/wire.h"

namespace csipose {

enum class StreamEvent {
  message,  ///< `message` was filled
  nothing,  ///< nothing came before the timeout
  closed,   ///< the server has closed; further calls say the same
};

class StreamClient {
 public:
  /// Connects and reads the hello. Throws SetupError: nobody there, no right, or what answers is no csiposed.
  StreamClient(const std::string& socket_path, Format format);

  const Hello& hello() const { return hello_; }
  int fd() const { return fd_.get(); }
  /// Asks, and waits for the answer; frames cannot come before it. Throws SetupError with the server's words
  /// when refused.
  Subscription subscribe(const Subscription& asked);
  void send(const ClientMessage& message);
  /// Throws SetupError when the server sends what is no message.
  StreamEvent next(Nanoseconds timeout, ServerMessage& message);
  /// The last message as it came, without length or newline.
  const std::string& raw() const { return raw_; }

 private:
  bool cut_message(Format format);
  StreamEvent next_raw(Format format, Nanoseconds timeout);
  void send_bytes(const std::string& bytes);

  FileDescriptor fd_;
  Format format_;
  std::string input_;
  std::size_t used_ = 0;
  std::string raw_;
  bool closed_ = false;
  Hello hello_;
};

}  // namespace csipose
