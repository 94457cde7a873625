#include "daemon/daemon.h"

#include <fmt/format.h>
#include <fmt/ranges.h>
#include <poll.h>
#include <signal.h>
#include <sys/signalfd.h>

#include <cerrno>
#include <cstdlib>
#include <cstring>
#include <filesystem>

#include "daemon/control.h"
#include "daemon/loop_thread.h"
#include "daemon/metrics.h"
#include "daemon/notify.h"
#include "daemon/publisher.h"
#include "daemon/settings.h"
#include "daemon/source_thread.h"
#include "daemon/status_report.h"
#include "proto/file_descriptor.h"
#include "version.h"

namespace csipose {
namespace {

constexpr std::size_t kRingBytes = 4 << 20;  // some 4 s of three receivers at 1,000 packets a second
constexpr Nanoseconds kTick = std::chrono::milliseconds(50);
constexpr Nanoseconds kStatusEvery = std::chrono::seconds(1);

/// The signals that main() has blocked, as a file to wait on.
class Signals {
 public:
  Signals() {
    sigset_t set;
    sigemptyset(&set);
    for (const int signal : {SIGTERM, SIGINT, SIGHUP, SIGUSR1, SIGUSR2}) sigaddset(&set, signal);
    file_ = FileDescriptor(signalfd(-1, &set, SFD_NONBLOCK | SFD_CLOEXEC));
    if (!file_)
      throw SetupError(ExitStatus::os_refusal, fmt::format("no signal file: {}", std::strerror(errno)));
  }
  int descriptor() const { return file_.get(); }
  /// The next signal that came, or 0.
  int next() {
    signalfd_siginfo info;
    return read(file_.get(), &info, sizeof info) == sizeof info ? static_cast<int>(info.ssi_signo) : 0;
  }
  void wait(Nanoseconds timeout) {
    pollfd waited{file_.get(), POLLIN, 0};
    poll(&waited, 1, static_cast<int>(ns(timeout) / 1'000'000));
  }

 private:
  FileDescriptor file_;
};

std::array<char, 12> first_digits(const std::string& digest) {
  std::array<char, 12> digits{};
  std::copy_n(digest.begin(), digits.size(), digits.begin());
  return digits;
}

int socket_named(const std::map<std::string, int>& inherited, const std::string& path) {
  const auto found = inherited.find(std::filesystem::path(path).filename());
  return found == inherited.end() ? -1 : found->second;
}

class PublisherSink final : public FrameSink {
 public:
  PublisherSink(Publisher& publisher, RecorderThread& recorder)
      : publisher_(publisher), recorder_(recorder) {}
  void publish(const PoseFrame& frame) override {
    publisher_.publish(frame);
    recorder_.offer(frame);
  }

 private:
  Publisher& publisher_;
  RecorderThread& recorder_;
};

}  // namespace

struct Daemon::State {
  State(ConfigSources from, Config checked, std::map<std::string, int> inherited, Log& to);

  void start();
  void run();
  void stop(const std::string& reason);

 private:
  PublisherConfig publisher_config(Source source, std::uint64_t session, int socket) const;
  LoopThread::Parts loop_parts();
  Status fixed_status(std::uint64_t session) const;
  bool asked_to_stop();
  [[noreturn]] void leave_while_loading();
  void say_ready(const LoopReady& ready);
  void warn_if_too_slow(const LoopReady& ready);
  ControlHandlers control_handlers();
  RecordingEntry set_recording(bool on);
  void wait_for_events();
  void on_signal(int signal);
  ReloadOutcome reload();
  void reload_on_signal();
  void tick();
  void report(SteadyTime now);
  void write_metrics();
  void feed_watchdog();
  void check_failures() const;

  const ConfigSources sources_;
  Config config_;
  Log& log_;
  const std::vector<std::string> receiver_ids_;
  const std::shared_ptr<const Model> model_;
  const std::uint64_t session_;
  PacketRing ring_{kRingBytes};
  LoopLink link_;
  SourceThread source_;
  RingInput input_;
  std::unique_ptr<RecorderThread> recorder_;
  Publisher publisher_;
  PublisherSink sink_;
  LoopThread loop_;
  Signals signals_;
  std::unique_ptr<ControlServer> control_;
  Status status_;
  ChangeReporter changes_;
  const SteadyTime started_ = steady_now();
  SteadyTime reported_{};
  std::uint64_t progress_seen_ = 0, reloads_ok_ = 0, reloads_refused_ = 0;
  std::string stop_reason_;
};

Daemon::State::State(ConfigSources from, Config checked, std::map<std::string, int> inherited, Log& to)
    : sources_(std::move(from)),
      config_(std::move(checked)),
      log_(to),
      receiver_ids_(receiver_ids(config_)),
      model_(load_model(config_)),
      session_(session_number(config_, *model_)),
      source_(make_source(config_, inherited), ring_, config_.source.kind == "file",
              [this](const Packet& packet) { recorder_->offer(packet); }),
      input_(ring_, source_),
      recorder_(make_recorder(config_, source_.source().kind())),
      publisher_(
          publisher_config(source_.source().kind(), session_, socket_named(inherited, config_.stream.socket)),
          {[this](const std::string& line) { log_.info(line); },
           [this](const std::string& line) { log_.warn(line); }}),
      sink_(publisher_, *recorder_),
      loop_(config_, loop_parts(), link_),
      status_(fixed_status(session_)),
      changes_(log_, receiver_ids_) {
  if (!config_.stream.control_socket.empty())
    control_ = std::make_unique<ControlServer>(config_.in_run_dir(config_.stream.control_socket), "",
                                               socket_named(inherited, config_.stream.control_socket),
                                               control_handlers());
}

PublisherConfig Daemon::State::publisher_config(Source source, std::uint64_t session, int socket) const {
  PublisherConfig publisher;
  publisher.socket_path = config_.in_run_dir(config_.stream.socket);
  publisher.inherited_fd = socket;
  publisher.max_clients = config_.stream.max_clients;
  publisher.limits = stream_limits(config_);
  publisher.hello = hello_of(config_, *model_, source, session);
  publisher.receiver_ids = receiver_ids_;
  publisher.lossless = source == Source::replay && config_.source.speed == 0;
  return publisher;
}

LoopThread::Parts Daemon::State::loop_parts() {
  FrameFacts facts;
  facts.session = session_;
  facts.source = source_.source().kind();
  facts.model = first_digits(model_->digest());
  facts.untrained = model_->untrained();
  facts.stale_after = std::chrono::milliseconds(config_.ingest.stale_after_ms);
  const int wanted = facts.source == Source::replay ? config_.source.wait_clients : 0;
  return {model_, input_, sink_, facts, [this, wanted] { return publisher_.subscribers() >= wanted; }};
}

Status Daemon::State::fixed_status(std::uint64_t session) const {
  Status status;
  status.name = config_.daemon.name;
  status.version = CSIPOSE_VERSION;
  status.commit = CSIPOSE_COMMIT;
  status.session = session;
  status.source = source_.source().kind();
  status.source_text = source_.source().describe();
  status.model = model_->digest();
  status.model_path = config_.model.path;
  status.model_text = fmt::format("{}, {:.1f} M parameters{}", model_->config().preset,
                                  static_cast<double>(parameter_count(model_->config())) / 1e6,
                                  model_->untrained() ? ", UNTRAINED" : "");
  status.untrained = model_->untrained();
  status.config_path = sources_.file.empty() ? kDefaultConfigFile : sources_.file;
  status.budget_ms = config_.loop.budget_ms;
  return status;
}

void Daemon::State::start() {
  if (config_.record.enabled) recorder_->start_recording();
  const std::optional<LoopReady> ready = loop_.start([this] { return asked_to_stop(); });
  if (!ready) leave_while_loading();
  status_.engine = ready->engine;
  say_ready(*ready);
  source_.start();
  notify_ready();
}

bool Daemon::State::asked_to_stop() {
  while (const int signal = signals_.next()) on_signal(signal);
  return !stop_reason_.empty();
}

/// The engine's loading cannot be broken off and nothing is served yet: say bye, close the recording, and go.
void Daemon::State::leave_while_loading() {
  publisher_.finish(stop_reason_);
  recorder_->stop_recording();
  log_.info(fmt::format("end reason=\"{}\" while the model was being loaded", stop_reason_));
  std::_Exit(static_cast<int>(ExitStatus::ok));
}

void Daemon::State::say_ready(const LoopReady& ready) {
  for (const std::string& refusal : ready.refusals) log_.warn(refusal);
  log_.info(fmt::format("model {} digest={} file={}", status_.model_text, status_.model, status_.model_path));
  if (status_.untrained) log_.warn("the model is UNTRAINED: its weights are random, its poses mean nothing");
  log_.info(fmt::format("engine {} infer_ms={:.2f} with_two_receivers={:.2f} with_one={:.2f}", ready.engine,
                        ready.infer_ms[3], ready.infer_ms[2], ready.infer_ms[1]));
  warn_if_too_slow(ready);
  log_.info(fmt::format("ready source=\"{}\" socket={} session={:016x} delay_ms={} poses_per_second={:.1f}",
                        status_.source_text, config_.in_run_dir(config_.stream.socket).string(), session_,
                        config_.loop.budget_ms, config_.window.sample_rate_hz / config_.window.hop));
}

void Daemon::State::warn_if_too_slow(const LoopReady& ready) {
  if (status_.source == Source::replay) return;
  const double hop_ms = 1e3 * config_.window.hop / config_.window.sample_rate_hz;
  const double time_ms = std::min<double>(hop_ms, config_.loop.budget_ms - config_.loop.jitter_ms);
  if (ready.infer_ms[kReceivers] > time_ms)
    log_.warn(
        fmt::format("the network needs {:.1f} ms, but only {:.1f} ms are left for it (loop.budget_ms - "
                    "loop.jitter_ms, window.hop): "
                    "results will be late and dropped; raise them, or choose a smaller model",
                    ready.infer_ms[kReceivers], time_ms));
}

void Daemon::State::run() {
  start();
  while (stop_reason_.empty()) {
    wait_for_events();
    tick();
  }
  stop(stop_reason_);
  check_failures();
}

void Daemon::State::stop(const std::string& reason) {
  notify_stopping();
  link_.stop = true;
  source_.stop();
  publisher_.finish(
      reason);  // before the loop: in a replay that loses nothing, it may be waiting for a client
  loop_.stop();
  recorder_->stop_recording();
  report(steady_now());
  log_.info(fmt::format("end reason=\"{}\" {}", reason, status_line(status_)));
}

void Daemon::State::wait_for_events() {
  if (control_)
    control_->serve(kTick, signals_.descriptor());
  else
    signals_.wait(kTick);
  asked_to_stop();
}

void Daemon::State::on_signal(int signal) {
  if (signal == SIGTERM || signal == SIGINT) stop_reason_ = "stopped";
  if (signal == SIGHUP) reload_on_signal();
  if (signal == SIGUSR1) recorder_->rotate();
  if (signal == SIGUSR2) log_.info(status_line(status_));
}

ControlHandlers Daemon::State::control_handlers() {
  ControlHandlers handlers;
  handlers.record_start = [this] { return set_recording(true); };
  handlers.record_stop = [this] { return set_recording(false); };
  handlers.record_list = [this] { return recorder_->list(); };
  handlers.status = [this] { return publisher_.status(); };
  handlers.reload = [this] {
    ReloadOutcome outcome = reload();
    outcome.applied.insert(outcome.applied.end(), outcome.needs_restart.begin(), outcome.needs_restart.end());
    return outcome.applied;
  };
  return handlers;
}

RecordingEntry Daemon::State::set_recording(bool on) {
  if (on)
    recorder_->start_recording();
  else
    recorder_->stop_recording();
  const RecordingStatus status = recorder_->status();
  log_.info(fmt::format("recording is {} folder={}", on ? "on" : "off",
                        config_.in_state_dir(config_.record.dir).string()));
  return {status.file, status.bytes, status.active};
}

ReloadOutcome Daemon::State::reload() try {
  notify_reloading();
  const bool recorded = config_.record.enabled;
  const ReloadOutcome outcome = apply_reload(config_, load_config(sources_));
  if (config_.record.enabled != recorded) set_recording(config_.record.enabled);
  log_.set_level(log_level_from(config_.daemon.log_level));
  publisher_.configure(stream_limits(config_), config_.stream.max_clients);
  link_.people.back() = estimator_config(config_);
  link_.people.publish();
  for (const std::string& line : outcome.needs_restart) log_.warn("reload: " + line);
  log_.info(fmt::format("reload done applied=[{}]", fmt::join(outcome.applied, ", ")));
  ++reloads_ok_;
  notify_ready();
  return outcome;
} catch (const SetupError& error) {
  ++reloads_refused_;
  log_.error(fmt::format("reload refused, the running configuration stays: {}", error.what()));
  notify_ready();
  throw;
}

void Daemon::State::reload_on_signal() {
  try {
    reload();
  } catch (const SetupError&) {
    // said in the log
  }
}

void Daemon::State::tick() {
  const SteadyTime now = steady_now();
  if (link_.status.refresh()) changes_.report(link_.status.front());
  if (now - reported_ >= kStatusEvery) report(now);
  if (source_.ended() && source_.failure()) stop_reason_ = "the source broke";
  if (loop_.ended()) stop_reason_ = loop_.failure() ? "fault" : "end of the recording";
}

void Daemon::State::report(SteadyTime now) {
  reported_ = now;
  feed_watchdog();
  link_.clock_error_ns = clock_error_ns();
  if (link_.status.refresh()) changes_.report(link_.status.front());
  fill_status(status_, link_.status.front(), source_.stats(), receiver_ids_);
  status_.uptime_s = seconds(now - started_);
  status_.recording = recorder_->status();
  status_.config_reloads = {{"ok", reloads_ok_}, {"refused", reloads_refused_}};
  publisher_.set_status(status_);
  write_metrics();
  notify_status(status_line(status_));
  log_.flush_repeats(now);
}

void Daemon::State::write_metrics() try {
  if (!config_.metrics.textfile.empty())
    write_metrics_file(config_.metrics.textfile, prometheus_text(publisher_.status(), process_use()));
} catch (const SetupError& error) {
  log_.warn(error.what());
}

void Daemon::State::feed_watchdog() {
  const std::uint64_t progress = link_.progress.load(std::memory_order_relaxed);
  if (progress == progress_seen_) return;  // the loop stands still: let systemd see it
  progress_seen_ = progress;
  ++status_.watchdog_pings;
  notify_watchdog();
}

void Daemon::State::check_failures() const {
  if (source_.failure()) std::rethrow_exception(source_.failure());
  if (loop_.failure()) std::rethrow_exception(loop_.failure());
}

Daemon::Daemon(ConfigSources sources, Config config, std::map<std::string, int> inherited_sockets, Log& log)
    : state_(std::make_unique<State>(std::move(sources), std::move(config), std::move(inherited_sockets),
                                     log)) {}
Daemon::~Daemon() = default;
void Daemon::run() { state_->run(); }

}  // namespace csipose
