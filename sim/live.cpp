#include "sim/live.h"

#include <fmt/format.h>
#include <poll.h>
#include <sys/prctl.h>

#include <algorithm>
#include <cerrno>
#include <cmath>
#include <cstdio>
#include <cstring>

#include "proto/notify.h"
#include "proto/result.h"
#include "proto/sealed_sender.h"
#include "proto/time.h"
#include "sim/packet_feed.h"
#include "sim/truth_server.h"

namespace csipose::sim {
namespace {

using namespace std::chrono_literals;

constexpr Nanoseconds kStatusEvery = 10s, kTendEvery = 50ms;
constexpr Nanoseconds kStarvedWait = 1ms;  // between looks for a packet that is not made yet
constexpr Nanoseconds kLate = 100ms;       // worth a word
constexpr Nanoseconds kGiveUp = 2s;        // so late, the rest is put off instead of being caught up with
constexpr double kAhead_s = 1;             // physics is so far ahead of the clock

TruthHello hello_of(const LiveOptions& options, const Scene& scene) {
  TruthHello hello{options.what,
                   options.seed,
                   options.rate_hz,
                   options.speed,
                   options.impair_name,
                   point(scene.room.size_m),
                   point(scene.transmitter.position),
                   {}};
  for (const auto& antennas : scene.receivers)
    hello.receivers_m.push_back(point(antennas[antennas.size() / 2].position));
  return hello;
}

std::size_t depth_for(const LiveOptions& options) {
  return std::max<std::size_t>(3 * kSamples,
                               static_cast<std::size_t>(kAhead_s * options.rate_hz * options.speed));
}

/// When packets are due. What is late is sent at once: the daemon goes by the cards' clocks, to which a sender that has
/// slept and hurries is a short gap, and one that goes on late is late for good. Only what cannot be caught up with is put off.
class Pace {
 public:
  explicit Pace(double speed) : speed_(speed) {}
  void start(SteadyTime now) { start_ = now; }
  SteadyTime due(const SentPacket& packet) const { return start_ + from_seconds(packet.sent_s / speed_); }
  /// The packet is sent now; by how much too late.
  Nanoseconds sent(const SentPacket& packet, SteadyTime now) {
    const Nanoseconds late = now - due(packet);
    if (late < kGiveUp) return late;
    start_ += late;
    put_off_ += late;
    return late;
  }
  Nanoseconds put_off() const { return put_off_; }

 private:
  double speed_;
  SteadyTime start_{};
  Nanoseconds put_off_{};
};

class Live {
 public:
  Live(const LiveOptions& options, std::unique_ptr<MovingScene> scene, const PollStop& signals)
      : options_(options), signals_(signals), pace_(options.speed) {
    for (std::size_t r = 0; r < kReceivers; ++r)
      if (!options.silent[r]) senders_[r] = std::make_unique<SealedSender>(options.keys[r], options.daemon);
    if (!options.truth_socket.empty())
      truth_ = std::make_unique<TruthServer>(options.truth_socket, hello_of(options, scene->still()));
    ahead_ = std::make_unique<ReadAhead>(
        PacketFeed(std::move(scene), options.radio, options.seed, options.clip, options.rate_hz),
        depth_for(options));
  }

  void run() {
    prctl(PR_SET_TIMERSLACK, 1UL);  // wake when asked, not up to 50 us later
    notify_systemd("READY=1");
    status_at_ = steady_now() + kStatusEvery;
    while (!PollStop::wanted() && !over_) {
      const SteadyTime now = steady_now();
      if (now >= tend_at_) tend(now);
      if (!playing_) begin_when_answered(now);
      if (playing_) send_due();
      wait();
    }
    report(steady_now());
  }

 private:
  void tend(SteadyTime now) {
    tend_at_ = now + kTendEvery;
    for (const auto& sender : senders_)
      if (sender) sender->tend(now);
    if (truth_) truth_->admit();
    if (now >= status_at_) {
      report(now);
      status_at_ += kStatusEvery;
    }
    if (const Nanoseconds watchdog = watchdog_interval(); watchdog > 0ns && now >= watchdog_at_) {
      notify_systemd("WATCHDOG=1");
      watchdog_at_ = now + watchdog;
    }
  }

  void begin_when_answered(SteadyTime now) {
    const bool all = std::all_of(senders_.begin(), senders_.end(),
                                 [&](const auto& sender) { return !sender || sender->connected(now); });
    if (!all || ahead_->ready() + kSamples < depth_for(options_)) {
      if (ahead_->ready() == 0) ahead_->front();  // throws if the physics broke
      return;
    }
    pace_.start(now);
    playing_ = true;
  }

  void send_due() {
    starved_ = false;
    while (const SentPacket* packet = ahead_->front()) {
      const SteadyTime now = steady_now();
      if (options_.seconds && packet->grid_s >= *options_.seconds) {
        over_ = true;
        return;
      }
      next_at_ = pace_.due(*packet);
      if (next_at_ > now) return;
      note_delay(pace_.sent(*packet, now), now);
      send(*packet, now);
      ahead_->pop();
    }
    starved_ = true;
    ++starvations_;
  }

  void send(const SentPacket& packet, SteadyTime now) {
    const UtcTime sent = utc_now();
    for (std::size_t r = 0; r < kReceivers; ++r)
      if (senders_[r] && !packet.records[r].empty()) senders_[r]->send(ByteView(packet.records[r]), now);
    if (truth_ && truth_->readers() > 0) truth_->send(truth_of(packet, sent));
    simulated_s_ = packet.grid_s;
    ++packets_;
  }

  void note_delay(Nanoseconds late, SteadyTime now) {
    most_late_ = std::max(most_late_, late);
    if (late < kLate || now < complain_at_) return;
    complain_at_ = now + kStatusEvery;
    say(fmt::format(
        "cannot keep up: {:.2f} s behind the clock, and the daemon takes what comes so late for lost. {}",
        seconds(late),
        starvations_ > 0 ? "The physics takes longer than the time it describes: fewer people, a lower "
                           "--rate or a lower --speed would do."
                         : "This host gave the program no time to send; is it busy with something else?"));
  }

  void wait() {
    const SteadyTime now = steady_now();
    SteadyTime until = tend_at_;
    if (playing_) until = std::min(until, starved_ ? now + kStarvedWait : next_at_);
    const std::int64_t left = std::max<std::int64_t>(0, ns(until - now));
    const timespec timeout = {static_cast<time_t>(left / 1'000'000'000),
                              static_cast<long>(left % 1'000'000'000)};
    // Answers of the daemon and readers of the truth can wait until tend().
    if (::ppoll(nullptr, 0, &timeout, signals_.while_waiting()) < 0 && errno != EINTR)
      throw SetupError(ExitStatus::os_refusal, fmt::format("waiting: {}", std::strerror(errno)));
  }

  void report(SteadyTime now) {
    const std::string status = fmt::format(
        "{}{:.1f} s simulated, {} packets, {} ahead, at most {:.2f} s late, {:.2f} s put off, {} reading the "
        "truth",
        playing_ ? "" : fmt::format("waiting for an answer from {}; ", options_.daemon), simulated_s_,
        packets_, ahead_->ready(), seconds(most_late_), seconds(pace_.put_off()),
        truth_ ? truth_->readers() : 0);
    say(status);
    for (std::size_t r = 0; r < kReceivers; ++r)
      say(fmt::format("{}: {}", options_.keys[r].name,
                      senders_[r] ? senders_[r]->status(now) : "switched off"));
    notify_systemd("STATUS=" + status);
  }

  static void say(const std::string& words) {
    std::fprintf(stderr, "csipose-sim: live: %s\n", words.c_str());
  }

  const LiveOptions& options_;
  const PollStop& signals_;
  std::array<std::unique_ptr<SealedSender>, kReceivers> senders_;  // none for one that is switched off
  std::unique_ptr<TruthServer> truth_;
  std::unique_ptr<ReadAhead> ahead_;
  Pace pace_;
  SteadyTime tend_at_{}, status_at_{}, watchdog_at_{}, complain_at_{}, next_at_{};
  bool playing_ = false, over_ = false, starved_ = false;
  double simulated_s_ = 0;
  std::uint64_t packets_ = 0, starvations_ = 0;
  Nanoseconds most_late_{};
};

}  // namespace

void run_live(const LiveOptions& options, std::unique_ptr<MovingScene> scene, const PollStop& signals) {
  Live(options, std::move(scene), signals).run();
}

}  // namespace csipose::sim
