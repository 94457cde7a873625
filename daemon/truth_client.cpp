#include "daemon/truth_client.h"

#include <fmt/format.h>
#include <poll.h>
#include <sys/socket.h>

#include <algorithm>
#include <array>
#include <cerrno>
#include <cmath>

namespace csipose {
namespace {

constexpr auto kHelloPatience = std::chrono::milliseconds(2000);

}  // namespace

TruthClient::TruthClient(const std::string& path)
    : path_(path),
      fd_(connect_unix(
          path, {"the simulator", "Start csipose-sim live --truth with this path, or name another."})) {
  pollfd readable{fd_.get(), POLLIN, 0};
  std::string line;
  while (!cut_line(line)) {
    if (closed_ || ::poll(&readable, 1, static_cast<int>(kHelloPatience.count())) <= 0)
      throw SetupError(
          ExitStatus::unavailable,
          fmt::format(
              "{} says nothing: it is no truth socket of csipose-sim live, or serves too many already.",
              path_));
    receive(0);
  }
  const auto said = parse_truth(line);
  if (!said || !std::holds_alternative<TruthHello>(*said))
    throw SetupError(ExitStatus::bad_data,
                     fmt::format("{} is no truth socket that this version understands: {}.", path_,
                                 said ? "it begins without a hello" : said.error()));
  hello_ = std::get<TruthHello>(*said);
}

void TruthClient::drain() {
  receive(MSG_DONTWAIT);
  for (std::string line; cut_line(line);) take(line);
}

const Truth* TruthClient::at(UtcTime time) { return nearest(time, 1 / (hello_.rate_hz * hello_.speed)); }

double TruthClient::age_s(const Truth& truth) const { return seconds(utc_now() - truth.sent); }

std::string TruthClient::silence() const {
  return closed_ ? "the simulator has ended" : "the simulator sends nothing at this time";
}

bool TruthClient::cut_line(std::string& line) {
  const std::size_t end = bytes_.find('\n');
  if (end == std::string::npos) {
    if (bytes_.size() > kMaxTruthLine)
      throw SetupError(ExitStatus::bad_data, fmt::format("{} sends no lines: it is no truth socket.", path_));
    return false;
  }
  line = bytes_.substr(0, end);
  bytes_.erase(0, end + 1);
  return true;
}

void TruthClient::receive(int flags) {
  std::array<char, 65536> buffer;
  for (bool more = !closed_; more;) {
    const ssize_t got = ::recv(fd_.get(), buffer.data(), buffer.size(), flags);
    if (got > 0) bytes_.append(buffer.data(), static_cast<std::size_t>(got));
    closed_ = got == 0 || (got < 0 && errno != EAGAIN && errno != EINTR);
    more = got == static_cast<ssize_t>(buffer.size()) && flags != 0;
  }
}

void TruthClient::take(const std::string& line) {
  auto said = parse_truth(line);
  if (!said)
    throw SetupError(ExitStatus::bad_data,
                     fmt::format("{} sends a line that is no truth: {}.", path_, said.error()));
  if (auto* truth = std::get_if<Truth>(&*said)) keep(std::move(*truth));
}

}  // namespace csipose
