#include "daemon/control.h"

#include <fmt/format.h>
#include <poll.h>
#include <sys/socket.h>

#include <algorithm>
#include <array>
#include <cerrno>
#include <cstring>
#include <nlohmann/json.hpp>
#include <optional>

#include "proto/time.h"
#include "proto/unix_socket.h"
#include "proto/wire.h"

namespace csipose {
namespace {

using Json = nlohmann::json;

constexpr std::size_t kMaxConnections = 16;
constexpr auto kControlTimeout =
    std::chrono::seconds(10);  // a reload may read a model's header from a slow disk

std::string line_of(const Json& json) {
  return json.dump(-1, ' ', false, Json::error_handler_t::replace) + '\n';
}

std::string refusal(const std::string& code, const std::string& text, const std::string& remedy) {
  return line_of({{"type", "error"}, {"code", code}, {"text", text}, {"remedy", remedy}});
}

Json describe(const RecordingEntry& recording) {
  return {{"file", recording.file}, {"bytes", recording.bytes}, {"active", recording.active}};
}

template <class Handler>
std::string cannot(const Handler& handler, const std::string& type) {
  return handler
             ? ""
             : refusal("not_here", fmt::format("This daemon cannot do {}.", type), "See its configuration.");
}

std::string answer_recording(const std::string& type, const std::function<RecordingEntry()>& handler) {
  if (auto words = cannot(handler, type); !words.empty()) return words;
  Json answer = describe(handler());
  answer["type"] = type;
  return line_of(answer);
}

std::string answer_list(const std::string& type, const ControlHandlers& handlers) {
  if (auto words = cannot(handlers.record_list, type); !words.empty()) return words;
  Json list = Json::array();
  for (const RecordingEntry& recording : handlers.record_list()) list.push_back(describe(recording));
  return line_of({{"type", type}, {"recordings", list}});
}

std::string answer_known(const std::string& type, const ControlHandlers& handlers) {
  if (type == "record.start") return answer_recording(type, handlers.record_start);
  if (type == "record.stop") return answer_recording(type, handlers.record_stop);
  if (type == "record.list") return answer_list(type, handlers);
  if (type == "reload") {
    if (auto words = cannot(handlers.reload, type); !words.empty()) return words;
    return line_of({{"type", type}, {"changes", handlers.reload()}});
  }
  if (type == "status") {
    if (auto words = cannot(handlers.status, type); !words.empty()) return words;
    return encode(Format::json, handlers.status());
  }
  return refusal("unknown_type", fmt::format("'{}' is nothing that can be asked here.", type),
                 "Ask for record.start, record.stop, record.list, reload or status.");
}

struct Connection {
  FileDescriptor fd;
  std::string input;
  bool over = false;
};

}  // namespace

std::string answer_control_request(const std::string& line, const ControlHandlers& handlers) {
  const Json request = Json::parse(line, nullptr, /*allow_exceptions=*/false);
  const auto type = request.is_object() ? request.find("type") : request.end();
  if (!request.is_object() || type == request.end() || !type->is_string())
    return refusal("bad_json", "The line is no JSON object with a \"type\".",
                   "Send a line such as {\"type\":\"status\"}.");
  if (request.size() > 1)
    return refusal("unknown_key", "The request has keys besides \"type\", and none is known.",
                   "Leave them out.");
  try {
    return answer_known(type->get<std::string>(), handlers);
  } catch (const SetupError& error) {
    return refusal("refused", error.what(), "");
  }
}

struct ControlServer::State {
  std::optional<SocketFile> file;
  FileDescriptor listener;
  ControlHandlers handlers;
  std::vector<Connection> connections;
  std::vector<pollfd> polled;

  void wait(Nanoseconds timeout, int wake_fd);
  void accept_all();
  void read_from(Connection& connection) const;
  void answer_lines(Connection& connection) const;
};

ControlServer::ControlServer(const std::string& path, const std::string& group, int inherited_fd,
                             ControlHandlers handlers)
    : state_(std::make_unique<State>()) {
  state_->handlers = std::move(handlers);
  if (inherited_fd >= 0) {
    state_->listener = FileDescriptor(inherited_fd);
  } else {
    state_->listener = listen_unix(path, group);
    state_->file.emplace(path);
  }
}
ControlServer::~ControlServer() = default;

void ControlServer::serve(Nanoseconds timeout, int wake_fd) {
  const SteadyTime until = steady_now() + timeout;
  do {
    state_->wait(std::max(until - steady_now(), Nanoseconds{0}), wake_fd);
    if (wake_fd >= 0 && state_->polled[0].revents != 0) return;
    for (std::size_t i = 0; i < state_->connections.size(); ++i)
      if (state_->polled[i + 2].revents != 0) state_->read_from(state_->connections[i]);
    auto& all = state_->connections;
    all.erase(std::remove_if(all.begin(), all.end(), [](const Connection& c) { return c.over; }), all.end());
    if (state_->polled[1].revents != 0) state_->accept_all();
  } while (steady_now() < until);
}

void ControlServer::State::wait(Nanoseconds timeout, int wake_fd) {
  polled = {{wake_fd, POLLIN, 0}, {listener.get(), POLLIN, 0}};
  for (const Connection& connection : connections) polled.push_back({connection.fd.get(), POLLIN, 0});
  poll(polled.data(), polled.size(),
       static_cast<int>(std::chrono::ceil<std::chrono::milliseconds>(timeout).count()));
}

void ControlServer::State::accept_all() {
  while (FileDescriptor fd =
             FileDescriptor(accept4(listener.get(), nullptr, nullptr, SOCK_CLOEXEC | SOCK_NONBLOCK))) {
    if (connections.size() == kMaxConnections)
      connections.erase(connections.begin());  // the oldest has had its time
    connections.push_back({std::move(fd), {}, false});
  }
}

void ControlServer::State::read_from(Connection& connection) const {
  std::array<char, 4096> buffer;
  const ssize_t size = recv(connection.fd.get(), buffer.data(), buffer.size(), MSG_DONTWAIT);
  if (size > 0) {
    connection.input.append(buffer.data(), static_cast<std::size_t>(size));
    answer_lines(connection);
  }
  if (size == 0 || (size < 0 && errno != EAGAIN && errno != EINTR)) connection.over = true;
  if (connection.input.size() > kMaxRequestBytes) connection.over = true;
}

void ControlServer::State::answer_lines(Connection& connection) const {
  std::size_t begin = 0;
  for (std::size_t end = 0; (end = connection.input.find('\n', begin)) != std::string::npos;
       begin = end + 1) {
    const std::string answer = answer_control_request(connection.input.substr(begin, end - begin), handlers);
    const ssize_t sent = send(connection.fd.get(), answer.data(), answer.size(), MSG_NOSIGNAL | MSG_DONTWAIT);
    if (sent != static_cast<ssize_t>(answer.size())) connection.over = true;  // asks, and does not read
  }
  connection.input.erase(0, begin);
}

namespace {

/// Up to the first newline, or nothing when the daemon is stuck.
std::string read_line(int fd) {
  std::string line;
  const SteadyTime until = steady_now() + kControlTimeout;
  while (line.find('\n') == std::string::npos) {
    const auto left = std::chrono::ceil<std::chrono::milliseconds>(until - steady_now());
    pollfd polled{fd, POLLIN, 0};
    if (left.count() <= 0 || poll(&polled, 1, static_cast<int>(left.count())) == 0) return "";
    std::array<char, 4096> buffer;
    const ssize_t size = recv(fd, buffer.data(), buffer.size(), 0);
    if (size == 0 || (size < 0 && errno != EINTR)) return "";
    if (size > 0) line.append(buffer.data(), static_cast<std::size_t>(size));
  }
  return line.substr(0, line.find('\n'));
}

}  // namespace

std::string ask_daemon(const std::string& control_socket, const std::string& type) {
  const FileDescriptor fd = connect_unix(control_socket);
  const std::string request = line_of({{"type", type}});
  send(fd.get(), request.data(), request.size(), MSG_NOSIGNAL);
  const std::string line = read_line(fd.get());
  const Json answer = Json::parse(line, nullptr, /*allow_exceptions=*/false);
  if (!answer.is_object())
    throw SetupError(ExitStatus::unavailable,
                     fmt::format("The daemon at {} gave no answer to {} within 10 s; it is stuck "
                                 "or ending.",
                                 control_socket, type));
  if (answer.value("type", "") == "error")
    throw SetupError(ExitStatus::runtime, fmt::format("The daemon refused {}: {} {}", type,
                                                      answer.value("text", ""), answer.value("remedy", "")));
  return line;
}

}  // namespace csipose
