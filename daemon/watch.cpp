#include "daemon/watch.h"

#include <fmt/format.h>

#include <algorithm>
#include <memory>

#include "daemon/live_view.h"
#include "daemon/stream_client.h"
#include "daemon/terminal.h"
#include "daemon/truth_client.h"
#include "daemon/truth_recording.h"
#include "proto/time.h"

namespace csipose {
namespace {

constexpr float kDrawHz = 15;
constexpr auto kOld = std::chrono::milliseconds(1500);  // a state frame comes at least once a second
constexpr auto kRateOver = std::chrono::seconds(2);     // frames per second are told over this

Subscription subscription_for(const WatchOptions& options) {
  Subscription asked;
  asked.pose = true;
  asked.max_hz = options.max_hz;
  if (options.format != WatchFormat::live) return asked;
  asked.status = true;
  asked.on_full = OnFull::latest;
  asked.max_hz = asked.max_hz > 0 ? std::min(asked.max_hz, kDrawHz) : kDrawHz;
  return asked;
}

/// The poses beside the truth of the instant that they speak of: the middle of their window.
class TruthWatch {
 public:
  explicit TruthWatch(std::unique_ptr<TruthSource> source) : source_(std::move(source)) {
    if (const TruthHello* hello = source_->hello()) view_.hello = *hello;
  }
  /// nullptr: nobody says what is true.
  static std::unique_ptr<TruthWatch> of(const WatchOptions& options) {
    std::unique_ptr<TruthSource> source;
    if (!options.truth.empty()) source = std::make_unique<TruthClient>(options.truth);
    if (!options.truth_recording.empty()) source = TruthRecording::open(options.truth_recording);
    return source ? std::make_unique<TruthWatch>(std::move(source)) : nullptr;
  }

  std::optional<FrameError> compare(const ReceivedPose& pose) {
    source_->drain();
    const Truth* truth = pose.frame.window_end > UtcTime{} ? source_->at(middle_of(pose.frame)) : nullptr;
    show(truth != nullptr ? truth : source_->newest());
    view_.with_poses = truth != nullptr;
    if (truth == nullptr) return std::nullopt;
    std::vector<Skeleton> claimed, real;
    for (std::size_t p = 0; p < pose.people_described; ++p) claimed.push_back(pose.frame.people[p].joints);
    for (const TruePerson& person : truth->people) real.push_back(person.joints);
    const FrameError error = meter_.add(claimed, real);
    view_.poses = meter_.poses();
    view_.guess = meter_.guess();
    return error;
  }
  /// When there is no pose, the newest.
  void show_newest() {
    source_->drain();
    view_.with_poses = false;
    show(source_->newest());
  }
  const TruthView& view() {
    if (view_.shown) view_.age_s = source_->age_s(*view_.shown);
    if (view_.age_s > seconds(kOld)) view_.shown.reset();
    view_.silence = source_->silence();
    return view_;
  }

 private:
  static UtcTime middle_of(const PoseFrame& frame) {
    return frame.window_start + (frame.window_end - frame.window_start) / 2;
  }
  void show(const Truth* truth) { view_.shown = truth == nullptr ? std::nullopt : std::optional(*truth); }

  std::unique_ptr<TruthSource> source_;
  ErrorMeter meter_;
  TruthView view_;
};

/// How often something happened of late.
class RateMeter {
 public:
  void count(SteadyTime now) {
    if (now - since_ > kRateOver) last_ = per_second(now), since_ = now, count_ = 0;
    ++count_;
  }
  double per_second(SteadyTime now) const {
    const double time_s = seconds(now - since_);
    return time_s < 0.5 ? last_ : static_cast<double>(count_) / time_s;
  }

 private:
  SteadyTime since_ = steady_now();
  std::uint64_t count_ = 0;
  double last_ = 0;
};

class Watcher {
 public:
  explicit Watcher(const WatchOptions& options)
      : options_(options),
        client_(options.socket, options.format == WatchFormat::jsonl ? Format::json : Format::protobuf),
        ends_(options.duration ? std::optional(steady_now() + *options.duration) : std::nullopt) {
    state_.hello = outcome_.hello = client_.hello();
    truth_ = TruthWatch::of(options);
    client_.subscribe(subscription_for(options));
    if (options.format == WatchFormat::live) screen_ = std::make_unique<LiveScreen>();
  }

  WatchOutcome run() {
    while (!over_ && !StopSignals::stop_wanted()) {
      const SteadyTime now = steady_now();
      if (ends_ && now >= *ends_) break;
      ServerMessage message;
      const Nanoseconds wait = ends_ ? std::min<Nanoseconds>(*ends_ - now, kOld / 3) : Nanoseconds(kOld / 3);
      const StreamEvent event = client_.next(wait, message);
      if (event == StreamEvent::closed) outcome_.vanished = over_ = true;
      if (event == StreamEvent::message) std::visit([this](const auto& said) { take(said); }, message);
      draw();
    }
    outcome_.interrupted = StopSignals::stop_wanted();
    if (truth_) outcome_.poses = truth_->view().poses, outcome_.guess = truth_->view().guess;
    return outcome_;
  }

 private:
  void take(const ReceivedPose& pose) {
    ++outcome_.frames;
    outcome_.lost += pose.dropped_before;
    outcome_.people = std::max<std::uint64_t>(outcome_.people, pose.frame.people_count);
    outcome_.last_state = pose.frame.state;
    over_ = options_.frames > 0 && outcome_.frames >= options_.frames;
    pose_at_ = steady_now();
    rate_.count(pose_at_);
    state_.pose = pose;
    const auto error = truth_ ? truth_->compare(pose) : std::nullopt;
    if (options_.format == WatchFormat::text)
      write(frame_line(pose) + (error ? error_words(*error) : "") + '\n');
    if (options_.format == WatchFormat::jsonl) write(client_.raw() + '\n');
    if (options_.format == WatchFormat::protobuf) write(with_length(client_.raw()));
  }
  void take(const ReceivedStatus& status) { state_.status = status; }
  void take(const Bye& bye) {
    outcome_.bye = bye.reason;
    over_ = true;
  }
  void take(const WireError& error) {
    throw SetupError(ExitStatus::runtime, error.text + ' ' + error.remedy);
  }
  void take(const Hello&) {}
  void take(const Subscribed&) {}
  void take(const Pong&) {}

  void write(const std::string& text) {
    if (!print_out(text)) over_ = true;  // nobody reads us any more
  }
  static std::string with_length(const std::string& message) {
    std::string bytes(4, '\0');
    store_le(reinterpret_cast<std::uint8_t*>(bytes.data()), static_cast<std::uint32_t>(message.size()));
    return bytes + message;
  }

  void draw() {
    if (!screen_) return;
    const SteadyTime now = steady_now();
    if (state_.pose && now - pose_at_ > kOld) state_.pose.reset();
    state_.silence = outcome_.frames == 0 ? "no frame has come yet"
                                          : "the stream has stopped; the last frame is too old to be true";
    state_.frames_per_second = rate_.per_second(now);
    state_.frames = outcome_.frames;
    state_.lost = outcome_.lost;
    if (truth_) {
      if (!state_.pose) truth_->show_newest();
      state_.truth = truth_->view();
    }
    const TerminalSize size = terminal_size();
    screen_->draw(render_live(state_, size.columns, size.rows), size);
  }

  WatchOptions options_;
  StopSignals signals_;
  StreamClient client_;
  std::optional<SteadyTime> ends_;
  std::unique_ptr<TruthWatch> truth_;
  std::unique_ptr<LiveScreen> screen_;
  LiveState state_;
  WatchOutcome outcome_;
  RateMeter rate_;
  SteadyTime pose_at_{};
  bool over_ = false;
};

}  // namespace

WatchOutcome watch(const WatchOptions& options) { return Watcher(options).run(); }

std::string conclude(const WatchOptions& options, const WatchOutcome& outcome) {
  const std::string counted =
      fmt::format("{} frames{}, at most {} people in one", outcome.frames,
                  outcome.lost > 0 ? fmt::format(" ({} lost on the way)", outcome.lost) : "", outcome.people);
  const bool enough = options.frames == 0 || outcome.frames >= options.frames;
  if (outcome.vanished)
    throw SetupError(ExitStatus::runtime,
                     fmt::format("The daemon went away without a word after {}; its log says why.", counted));
  if (!enough && !outcome.interrupted)
    throw SetupError(ExitStatus::runtime,
                     fmt::format("The stream ended ({}) after {}; {} frames were asked for.",
                                 outcome.bye.empty() ? "time is up" : outcome.bye, counted, options.frames));
  std::string sentence = fmt::format(
      "{}: {}", outcome.bye.empty() ? "watched" : "the stream ended (" + outcome.bye + ")", counted);
  if (outcome.poses)
    sentence +=
        fmt::format("\n  against the truth, {} frames: poses {}\n  a constant guess, the mean pose: {}",
                    outcome.poses->frames, accuracy_words(*outcome.poses), accuracy_words(*outcome.guess));
  return sentence;
}

}  // namespace csipose
