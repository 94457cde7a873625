#include "daemon/stream_client.h"

#include <fmt/format.h>
#include <poll.h>
#include <sys/socket.h>

#include <array>
#include <cerrno>
#include <cstring>

#include "proto/time.h"

namespace csipose {
namespace {

constexpr auto kAnswerTimeout = std::chrono::seconds(5);

[[noreturn]] void not_ours(const std::string& why) {
  throw SetupError(ExitStatus::unavailable,
                   fmt::format("What answers is no csiposed of this version: {} Check the socket's "
                               "path and that tool and daemon are from one build.",
                               why));
}

/// Rounded up, so that a timeout of a fraction of a millisecond does not spin.
int poll_ms(Nanoseconds left) {
  return static_cast<int>(
      std::chrono::ceil<std::chrono::milliseconds>(std::max(left, Nanoseconds{0})).count());
}

}  // namespace

StreamClient::StreamClient(const std::string& socket_path, Format format)
    : fd_(connect_unix(socket_path)), format_(format) {
  if (next_raw(Format::json, kAnswerTimeout) != StreamEvent::message) not_ours("it said nothing for 5 s.");
  auto said = parse_server_message(Format::json, ByteView(raw_));
  if (!said) not_ours(said.error().text);
  if (const auto* refusal = std::get_if<WireError>(&*said))
    throw SetupError(ExitStatus::try_again, refusal->text + ' ' + refusal->remedy);
  const auto* hello = std::get_if<Hello>(&*said);
  if (hello == nullptr) not_ours("it did not say hello.");
  hello_ = *hello;
  if (format_ == Format::protobuf) send_bytes(std::string(1, kProtobufMark));
}

Subscription StreamClient::subscribe(const Subscription& asked) {
  send(ClientMessage{asked});
  ServerMessage answer;
  if (next(kAnswerTimeout, answer) != StreamEvent::message)
    throw SetupError(ExitStatus::unavailable,
                     "The daemon did not answer the subscription within 5 s; it is stuck or ending.");
  if (const auto* refusal = std::get_if<WireError>(&answer))
    throw SetupError(ExitStatus::unavailable, refusal->text + ' ' + refusal->remedy);
  const auto* subscribed = std::get_if<Subscribed>(&answer);
  if (subscribed == nullptr) not_ours("it answered a subscription with something else.");
  return subscribed->granted;
}

void StreamClient::send(const ClientMessage& message) { send_bytes(encode(format_, message)); }

void StreamClient::send_bytes(const std::string& bytes) {
  for (std::size_t at = 0; at < bytes.size();) {
    const ssize_t size = ::send(fd_.get(), bytes.data() + at, bytes.size() - at, MSG_NOSIGNAL);
    if (size < 0 && errno == EINTR) continue;
    if (size < 0) return;  // closed by the server: the next read says so, after its last words
    at += static_cast<std::size_t>(size);
  }
}

StreamEvent StreamClient::next(Nanoseconds timeout, ServerMessage& message) {
  const StreamEvent event = next_raw(format_, timeout);
  if (event != StreamEvent::message) return event;
  auto said = parse_server_message(format_, ByteView(raw_));
  if (!said) not_ours(said.error().text);
  message = *said;
  return event;
}

/// Moves one whole message from input_ to raw_.
bool StreamClient::cut_message(Format format) {
  const std::string_view rest = std::string_view(input_).substr(used_);
  std::size_t begin = 0, size = rest.find('\n'), end = size + 1;
  if (format == Format::protobuf) {
    if (rest.size() < 4) return false;
    size = load_le<std::uint32_t>(reinterpret_cast<const std::uint8_t*>(rest.data()));
    begin = 4;
    end = begin + size;
    if (size > kMaxServerMessageBytes) not_ours("a message of more than 1 MiB.");
    if (rest.size() < end) return false;
  } else if (size == std::string_view::npos) {
    if (rest.size() > kMaxServerMessageBytes) not_ours("a line of more than 1 MiB.");
    return false;
  }
  raw_.assign(rest.substr(begin, size));
  used_ += end;
  return true;
}

StreamEvent StreamClient::next_raw(Format format, Nanoseconds timeout) {
  const SteadyTime deadline = steady_now() + timeout;
  while (!cut_message(format)) {
    if (closed_) return StreamEvent::closed;
    input_.erase(0, std::exchange(used_, 0));
    pollfd polled{fd_.get(), POLLIN, 0};
    const int ready = poll(&polled, 1, poll_ms(deadline - steady_now()));
    if (ready < 0 && errno == EINTR) return StreamEvent::nothing;  // a signal: let the caller look
    if (ready == 0) return StreamEvent::nothing;
    std::array<char, 16384> buffer;
    const ssize_t size = recv(fd_.get(), buffer.data(), buffer.size(), 0);
    if (size > 0) input_.append(buffer.data(), static_cast<std::size_t>(size));
    if (size == 0 || (size < 0 && errno != EINTR && errno != EAGAIN)) closed_ = true;
  }
  return StreamEvent::message;
}

}  // namespace csipose
