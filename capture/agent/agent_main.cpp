// csipose-agent: on a receiver's host. Netlink, or a .dat file for testing, to sealed datagrams. One thread,
// one loop.
#include <poll.h>
#include <sys/prctl.h>

#include <algorithm>
#include <cerrno>
#include <cstdio>
#include <cstring>
#include <exception>
#include <memory>

#include "capture/agent/dat_player.h"
#include "capture/agent/options.h"
#include "capture/agent/outlet.h"
#include "capture/frame_pairer.h"
#include "capture/netlink.h"
#include "proto/keys.h"
#include "proto/notify.h"
#include "proto/poll_stop.h"
#include "proto/record_stream.h"
#include "proto/result.h"
#include "proto/time.h"
#include "version.h"

namespace csipose {
namespace {

class Agent {
 public:
  Agent(const AgentOptions& options, std::unique_ptr<Outlet> outlet)
      : name_(options.id), outlet_(std::move(outlet)) {
    if (options.dat_file.empty())
      netlink_ = std::make_unique<NetlinkSocket>(csi_connector_of_this_host());
    else
      player_ = std::make_unique<DatPlayer>(options.dat_file, options.play);
  }

  void run() {
    prctl(PR_SET_TIMERSLACK, 1UL);  // wake when asked, not up to 50 us later: a played file is paced by it
    notify_systemd("READY=1");
    const Nanoseconds watchdog = watchdog_interval();
    SteadyTime status_at = steady_now() + kStatusEvery, watchdog_at = steady_now();
    while (!PollStop::wanted() && !(player_ && player_->ended())) {
      const SteadyTime now = steady_now();
      outlet_->tend(now);
      netlink_ ? pass_netlink() : play(now);
      if (now >= status_at) {
        report(now);
        status_at += kStatusEvery;
      }
      if (watchdog > Nanoseconds::zero() && now >= watchdog_at) {
        notify_systemd("WATCHDOG=1");
        watchdog_at = now + watchdog;
      }
      wait();
    }
    report(steady_now());
  }

 private:
  static constexpr auto kStatusEvery = std::chrono::seconds(10);
  static constexpr auto kTendEvery = std::chrono::milliseconds(50);

  void pass_netlink() {
    for (ByteView record = netlink_->take(); !record.empty(); record = netlink_->take()) {
      const ByteView records = pairer_.add(record);
      const bool has_csi =
          !records.empty() && (records[2] == kCsiCode || records.size() > 2u + load_be16(records.data()));
      if (has_csi) outlet_->send(records, steady_now());  // a frame without CSI is of no use to the daemon
    }
    const NetlinkSocket::Counts& counts = netlink_->counts();
    std::uint64_t lost = counts.overflows;
    for (const std::uint64_t count : counts.faults) lost += count;
    outlet_->lost_in_host(lost);
  }

  void play(SteadyTime now) {
    if (!playing_) {
      if (!outlet_->ready(now)) return;
      player_->start(now);
      playing_ = true;
    }
    while (!player_->ended() && player_->next_at() <= steady_now())
      outlet_->send(player_->take(), steady_now());
  }

  void wait() {
    SteadyTime until = steady_now() + kTendEvery;
    if (player_ && player_->ended()) return;
    if (playing_) until = std::min(until, player_->next_at());
    const auto left = std::max<std::int64_t>(0, ns(until - steady_now()));
    const timespec timeout = {static_cast<time_t>(left / 1'000'000'000),
                              static_cast<long>(left % 1'000'000'000)};
    pollfd fds[2] = {{outlet_->descriptor(), POLLIN, 0}, {netlink_ ? netlink_->descriptor() : -1, POLLIN, 0}};
    if (::ppoll(fds, 2, &timeout, signals_.while_waiting()) < 0 && errno != EINTR)
      throw SetupError(ExitStatus::os_refusal, std::string("waiting for packets: ") + std::strerror(errno));
  }

  void report(SteadyTime now) const {
    const std::string status = outlet_->status(now);
    std::fprintf(stderr, "csipose-agent: %s: %s\n", name_.c_str(), status.c_str());
    notify_systemd("STATUS=" + status);
  }

  std::string name_;
  std::unique_ptr<Outlet> outlet_;
  std::unique_ptr<NetlinkSocket> netlink_;
  std::unique_ptr<DatPlayer> player_;
  bool playing_ = false;
  FramePairer pairer_;
  PollStop signals_;
};

std::unique_ptr<Outlet> open_outlet(const AgentOptions& options) {
  if (!options.csitool_tcp.empty()) return open_csitool_outlet(options.csitool_tcp);
  const AgentKey key = load_agent_key(options.key_file);
  if (key.name != options.id)
    throw SetupError(ExitStatus::bad_config, "key file " + options.key_file + " is for receiver " + key.name +
                                                 ", not for " + options.id +
                                                 "; take the key of this receiver, or give --id " + key.name);
  return open_sealed_outlet(key, options.to);
}

int run(const std::vector<std::string>& arguments) {
  const AgentOptions options = parse_agent_options(arguments);
  if (options.help) return std::fputs(kAgentHelp, stdout), 0;
  if (options.version) return std::printf("csipose-agent %s (%s)\n", CSIPOSE_VERSION, CSIPOSE_COMMIT), 0;
  Agent(options, open_outlet(options)).run();
  return 0;
}

}  // namespace
}  // namespace csipose

int main(int argc, char** argv) {
  try {
    return csipose::run({argv + 1, argv + argc});
  } catch (const csipose::SetupError& error) {
    std::fprintf(stderr, "csipose-agent: %s\n", error.what());
    return static_cast<int>(error.status);
  } catch (const std::exception& error) {
    std::fprintf(stderr, "csipose-agent: %s\n", error.what());
    return static_cast<int>(csipose::ExitStatus::runtime);
  }
}
