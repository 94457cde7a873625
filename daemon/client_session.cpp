#include "daemon/client_session.h"

#include <algorithm>
#include <cassert>
#include <cstring>

namespace csipose {
namespace {
constexpr std::size_t kLengthBytes = 4;
constexpr double kLongestPeriod_ns = 86400e9;  // a day; rates below that are one frame a day

/// Before a subscription, and after it.
Subscription nothing_granted() {
  Subscription nothing;
  nothing.level = Level::presence;
  return nothing;
}
}  // namespace

void SharedFrame::assign(const PoseFrame& frame) {
  frame_ = frame;
  made_.reset();
}

const std::string& SharedFrame::body(Level level, Format format) {
  const std::size_t i = (static_cast<std::size_t>(level) - 1) * 2 + static_cast<std::size_t>(format);
  if (!made_[i]) encoder_.encode_body(frame_, level, format, bodies_[i]);
  made_.set(i);
  return bodies_[i];
}

SharedFramePtr SharedFramePool::take(const PoseFrame& frame) {
  auto idle =
      std::find_if(frames_.begin(), frames_.end(), [](const auto& known) { return known.use_count() == 1; });
  if (idle == frames_.end()) idle = frames_.insert(frames_.end(), std::make_shared<SharedFrame>(encoder_));
  (*idle)->assign(frame);
  return *idle;
}

ClientSession::ClientSession(const StreamLimits& limits, const std::string& hello_line, SteadyTime now)
    : limits_(limits),
      tokens_at_(now),
      progress_at_(now),
      granted_(nothing_granted()),
      answers_(hello_line) {}

// ---- In ----

void ClientSession::receive(ByteView bytes, SteadyTime now) {
  if (closing_ || dead_) return;
  input_.append(reinterpret_cast<const char*>(bytes.data()), bytes.size());
  if (!format_ && !input_.empty()) choose_format();
  read_requests(now);
  input_.erase(0, input_used_);
  input_used_ = 0;
}

void ClientSession::choose_format() {
  if (input_.front() == '{') {
    format_ = Format::json;
  } else if (input_.front() == kProtobufMark) {
    format_ = Format::protobuf;
    input_used_ = 1;
  } else {
    refuse_for_good({"unknown_format", "The first byte chooses the format, and this one chooses none.",
                     "Begin with { for JSON lines, or with the byte 0x01 for length-prefixed protobuf."});
  }
}

void ClientSession::read_requests(SteadyTime now) {
  while (!closing_ && !dead_) {
    const std::optional<ByteView> request = next_request();
    if (!request) return;
    handle(*request, now);
  }
}

/// One whole request, without newline or length; nullopt when it has not all come.
std::optional<ByteView> ClientSession::next_request() {
  const ByteView rest = ByteView(input_).sub(input_used_);
  std::size_t size = 0, framing = 0;
  if (format() == Format::json) {
    const void* end = rest.empty() ? nullptr : std::memchr(rest.data(), '\n', rest.size());
    size = end == nullptr ? rest.size()
                          : static_cast<std::size_t>(static_cast<const std::uint8_t*>(end) - rest.data());
    if (size <= kMaxRequestBytes && end == nullptr) return std::nullopt;
    framing = 1;
  } else {
    if (rest.size() < kLengthBytes) return std::nullopt;
    size = load_le<std::uint32_t>(rest.data());
    framing = kLengthBytes;
    if (size <= kMaxRequestBytes && rest.size() < framing + size) return std::nullopt;
  }
  if (size > kMaxRequestBytes) {
    refuse_for_good(
        {"too_long", "The request has more than 16 KiB.", "Connect again and send shorter requests."});
    return std::nullopt;
  }
  input_used_ += framing + size;
  return rest.sub(format() == Format::json ? 0 : framing, size);
}

bool ClientSession::within_rate(SteadyTime now) {
  const double refill = seconds(now - tokens_at_) * kMaxRequestsPerSecond;
  request_tokens_ = std::min<double>(kMaxRequestsPerSecond, request_tokens_ + std::max(0.0, refill));
  tokens_at_ = now;
  if (request_tokens_ < 1) return false;
  request_tokens_ -= 1;
  return true;
}

void ClientSession::handle(ByteView request, SteadyTime now) {
  if (!within_rate(now))
    return answer(
        encode(format(), WireError{"too_many_requests", "More than 20 requests came within a second.",
                                   "This one was not carried out; wait a second."}));
  const auto message = parse_client_message(format(), request);
  if (!message) return answer(encode(format(), message.error()));
  std::visit([this](const auto& said) { carry_out(said); }, *message);
}

void ClientSession::carry_out(const Subscription& asked) {
  grant(asked);
  answer(encode(format(), Subscribed{granted_}));
}

/// Lowered to what is allowed, never raised.
void ClientSession::grant(const Subscription& asked) {
  granted_ = asked;
  granted_.level =
      std::min({asked.level, limits_.max_level, Level::pose});  // no CSI is streamed: raw is lowered too
  if (asked.max_hz > limits_.pose_hz) granted_.max_hz = limits_.pose_hz;
  granted_.queue = asked.queue == 0 ? limits_.queue_frames : std::min(asked.queue, limits_.queue_frames);
  if (asked.on_full == OnFull::latest) granted_.queue = 1;
  status_requested_ = granted_.status;
  due_ns_ = 0;
  if (!granted_.pose) queue_.clear();
  while (queue_.size() > granted_.queue) make_room();
}

void ClientSession::carry_out(const Unsubscription&) {
  granted_ = nothing_granted();
  queue_.clear();
  status_.reset();
  answer(encode(format(), Subscribed{granted_}));
}

void ClientSession::carry_out(const Ping& ping) { answer(encode(format(), Pong{ping.id})); }

void ClientSession::carry_out(const Bye&) {
  queue_.clear();
  say_bye("you said bye");
}

void ClientSession::answer(const std::string& message) {
  if (answers_.size() + message.size() > kMaxAnswerBytes) dead_ = true;  // asks, and does not read
  if (!dead_) answers_ += message;
}

void ClientSession::refuse_for_good(const WireError& error) {
  queue_.clear();
  answer(encode(format(), error));
  say_bye(error.code);
}

void ClientSession::say_bye(const std::string& reason) {
  if (closing_) return;
  closing_ = true;
  bye_ = encode(format(), Bye{reason});
}

void ClientSession::offer(const SharedFramePtr& frame) {
  if (!granted_.pose || closing_ || dead_ || is_thinned_out(frame->frame())) return;
  if (queue_.size() >= granted_.queue) make_room();
  if (!closing_) queue_.push_back({frame, std::exchange(lost_, 0)});
}

void ClientSession::add_lost(std::uint32_t frames) {
  if (!granted_.pose || closing_) return;
  lost_ += frames;
  frames_dropped_ += frames;
}

/// Keeps to max_hz on the frames' own clock, so that a replay is thinned alike at any speed.
bool ClientSession::is_thinned_out(const PoseFrame& frame) {
  if (granted_.max_hz <= 0 || granted_.max_hz >= limits_.pose_hz) return false;
  const auto period_ns =
      static_cast<std::int64_t>(std::min(1e9 / static_cast<double>(granted_.max_hz), kLongestPeriod_ns));
  const std::int64_t slack_ns = period_ns / 20;  // frames' times differ a little from their rate
  const bool restarted =
      due_ns_ == 0 || frame.mono_ns > due_ns_ + period_ns || frame.mono_ns < due_ns_ - period_ns;
  if (restarted) due_ns_ = frame.mono_ns;
  if (frame.mono_ns + slack_ns < due_ns_) return true;
  due_ns_ += period_ns;
  return false;
}

void ClientSession::make_room() {
  if (granted_.on_full == OnFull::close) {
    frames_dropped_ += queue_.size();
    queue_.clear();
    return say_bye("overrun");
  }
  const std::uint32_t lost = queue_.front().dropped_before + 1;
  queue_.pop_front();
  ++frames_dropped_;
  (queue_.empty() ? lost_ : queue_.front().dropped_before) += lost;
}

void ClientSession::offer_status(std::shared_ptr<const std::string> message) {
  if (granted_.status && !closing_) status_ = std::move(message);
}

void ClientSession::set_max_level(Level max_level) {
  limits_.max_level = max_level;
  granted_.level = std::min(granted_.level, max_level);
}

// ---- Out ----

ClientSession::Parts ClientSession::next_bytes() {
  if (dead_ || (!outgoing_ && !start_next())) return {};
  return outgoing_parts();
}

/// Answers first, then the status, then frames in turn, and bye at the very end.
bool ClientSession::start_next() {
  Outgoing next;
  if (!answers_.empty()) {
    next.own = std::exchange(answers_, {});
  } else if (status_) {
    next.shared = std::exchange(status_, nullptr);
  } else if (!queue_.empty()) {
    next.frame = std::move(queue_.front().frame);
    next.level = granted_.level;
    next.around =
        envelope(format(), next.frame->body(next.level, format()).size(), queue_.front().dropped_before);
    queue_.pop_front();
  } else if (!bye_.empty()) {
    next.own = std::exchange(bye_, {});
  } else {
    return false;
  }
  outgoing_ = std::move(next);
  return true;
}

ClientSession::Parts ClientSession::outgoing_parts() const {
  const Outgoing& out = *outgoing_;
  Parts parts;
  if (out.frame) {
    parts = {std::string_view(out.around.head.data(), out.around.head_size),
             out.frame->body(out.level, format()),
             std::string_view(out.around.tail.data(), out.around.tail_size)};
  } else {
    parts = {out.shared ? std::string_view(*out.shared) : std::string_view(out.own)};
  }
  std::size_t taken = out.taken;
  for (std::string_view& part : parts) {
    const std::size_t here = std::min(taken, part.size());
    part.remove_prefix(here);
    taken -= here;
  }
  return parts;
}

void ClientSession::sent(std::size_t bytes, SteadyTime now) {
  assert(outgoing_);
  outgoing_->taken += bytes;
  if (bytes > 0) progress_at_ = now;
  const Parts left = outgoing_parts();
  if (std::any_of(left.begin(), left.end(), [](std::string_view part) { return !part.empty(); })) return;
  if (outgoing_->frame) ++frames_sent_;
  outgoing_.reset();
}

// ---- State ----

bool ClientSession::wants_output() const {
  return !dead_ && (outgoing_ || !answers_.empty() || status_ || !queue_.empty() || !bye_.empty());
}
bool ClientSession::finished() const { return dead_ || (closing_ && !wants_output()); }

bool ClientSession::idle_too_long(SteadyTime now) {
  if (!wants_output()) progress_at_ = now;
  return now - progress_at_ > limits_.idle_close;
}

bool ClientSession::has_room() const {
  return !granted_.pose || closing_ || dead_ || queue_.size() < granted_.queue;
}

bool ClientSession::take_status_request() {
  return std::exchange(status_requested_, false) && granted_.status;
}

}  // namespace csipose
