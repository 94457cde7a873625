#include "capture/live_source.h"

#include <poll.h>

#include <algorithm>
#include <cassert>
#include <cerrno>
#include <cstring>

#include "proto/result.h"

namespace csipose {
namespace {

// Takes until there is something or the time is over.
template <class Take>
SourceEvent take_or_wait(Nanoseconds timeout, pollfd* fds, std::size_t count, const Take& take) {
  const auto deadline = std::chrono::steady_clock::now() + timeout;
  for (;;) {
    if (take()) return SourceEvent::packet;
    const Nanoseconds left = deadline - std::chrono::steady_clock::now();
    if (left <= Nanoseconds::zero()) return SourceEvent::nothing;
    const timespec wait = {static_cast<time_t>(ns(left) / 1'000'000'000),
                           static_cast<long>(ns(left) % 1'000'000'000)};
    const int ready = ::ppoll(fds, count, &wait, nullptr);
    if (ready < 0 && errno == EINTR) return SourceEvent::nothing;  // a signal: let the caller look at it
    if (ready < 0)
      throw SetupError(ExitStatus::os_refusal, std::string("waiting for packets: ") + std::strerror(errno));
  }
}

}  // namespace

SourceEvent LiveSource::poll(Nanoseconds timeout, Packet& packet) {
  pollfd fd = {descriptor(), POLLIN, 0};
  return take_or_wait(timeout, &fd, 1, [&] { return take(packet); });
}

LiveSources::LiveSources(std::vector<std::unique_ptr<LiveSource>> sources) : sources_(std::move(sources)) {
  assert(!sources_.empty());
  for (const auto& source : sources_)
    if (source->kind() != kind())
      throw SetupError(ExitStatus::bad_config,
                       sources_.front()->describe() + " and " + source->describe() +
                           " do not go together: both must be live, both replayed or both simulated");
  for (const auto& source : sources_) fds_.push_back({source->descriptor(), POLLIN, 0});
}

SourceEvent LiveSources::poll(Nanoseconds timeout, Packet& packet) {
  return take_or_wait(timeout, fds_.data(), fds_.size(), [&] { return take_in_turn(packet); });
}

bool LiveSources::take_in_turn(Packet& packet) {
  for (std::size_t i = 0; i < sources_.size(); ++i) {
    turn_ = (turn_ + 1) % sources_.size();
    if (sources_[turn_]->take(packet)) return true;
  }
  return false;
}

std::string LiveSources::describe() const {
  std::string all;
  for (const auto& source : sources_) all += (all.empty() ? "" : " + ") + source->describe();
  return all;
}

SourceStats LiveSources::stats() const {
  SourceStats sum;
  for (const auto& source : sources_) {
    SourceStats stats = source->stats();
    for (std::size_t i = 0; i < kReceivers; ++i)
      if (stats.receivers[i].packets + stats.receivers[i].sessions > 0) sum.receivers[i] = stats.receivers[i];
    sum.refusals.insert(sum.refusals.end(), stats.refusals.begin(), stats.refusals.end());
  }
  return sum;
}

Now now_on_both_clocks() { return {steady_now(), utc_now()}; }

}  // namespace csipose
