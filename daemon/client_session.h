// daemon/client_session.h - one client of the stream: what it asked, what it gets, what it has lost. No
// socket, no clock.
//
// Bytes go in with the time they came, bytes come out when the socket has room; the publisher moves them. A
// frame's bytes are shared by all clients of one level and format, so a client costs its place in line, not a
// copy.
#pragma once

#include <array>
#include <bitset>
#include <deque>
#include <memory>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "proto/time.h"
#include "proto/wire.h"

namespace csipose {

/// A frame on its way to clients; encoded at the first use of each level and format. One thread.
class SharedFrame {
 public:
  explicit SharedFrame(FrameEncoder& encoder) : encoder_(encoder) {}
  void assign(const PoseFrame& frame);
  const PoseFrame& frame() const { return frame_; }
  const std::string& body(Level level, Format format);

 private:
  FrameEncoder& encoder_;
  PoseFrame frame_;
  std::array<std::string, 8> bodies_;  ///< [level - 1][format]; strings keep their memory from frame to frame
  std::bitset<8> made_;
};
using SharedFramePtr = std::shared_ptr<SharedFrame>;

/// Frames whose bytes nobody needs any more are used again. One thread.
class SharedFramePool {
 public:
  explicit SharedFramePool(std::vector<std::string> receiver_ids) : encoder_(std::move(receiver_ids)) {}
  SharedFramePtr take(const PoseFrame& frame);

 private:
  FrameEncoder encoder_;
  std::vector<SharedFramePtr> frames_;
};

/// What may be granted.
struct StreamLimits {
  Level max_level = Level::pose;   ///< privacy.max_level
  std::uint32_t queue_frames = 8;  ///< when a client does not say; 1..kMaxQueueFrames
  float pose_hz = 30;              ///< asking for more gives this
  Nanoseconds idle_close = std::chrono::seconds(10);
};
inline constexpr std::uint32_t kMaxQueueFrames = 64;
inline constexpr int kMaxRequestsPerSecond = 20;
inline constexpr std::size_t kMaxAnswerBytes = 64 * 1024;

class ClientSession {
 public:
  /// The hello is the first thing that goes out.
  ClientSession(const StreamLimits& limits, const std::string& hello_line, SteadyTime now);

  // ---- In ----
  /// Bytes that the client sent. Whatever they are: an answer, an error with words, or the end of this
  /// session.
  void receive(ByteView bytes, SteadyTime now);
  /// One frame for it; passed over when not subscribed or above its max_hz. A full ring does what the client
  /// chose.
  void offer(const SharedFramePtr& frame);
  /// Frames that were lost before they came here; told with the next one.
  void add_lost(std::uint32_t frames);
  /// The newest status in its format; an older one that has not begun to go out is forgotten.
  void offer_status(std::shared_ptr<const std::string> message);
  void set_max_level(Level max_level);
  /// Says bye after what is queued already; nothing more is taken in.
  void say_bye(const std::string& reason);

  // ---- Out ----
  using Parts = std::array<std::string_view, 3>;
  /// What to send next, up to the end of one message; empty parts = nothing. Valid until anything else is
  /// called.
  Parts next_bytes();
  /// That many of those were taken by the socket.
  void sent(std::size_t bytes, SteadyTime now);

  // ---- State ----
  bool wants_output() const;
  /// Everything is said, or the client broke the rules for good: close the socket.
  bool finished() const;
  /// It has taken nothing for idle_close although there was something to take. Asked often: the time counts
  /// from the last time that nothing was waiting.
  bool idle_too_long(SteadyTime now);
  /// A lossless publisher may offer a frame.
  bool has_room() const;
  bool wants_pose() const { return granted_.pose; }
  bool wants_status() const { return granted_.status; }
  /// True once after each subscription to status: the newest is due at once.
  bool take_status_request();
  Format format() const { return format_.value_or(Format::json); }
  Level level() const { return granted_.level; }
  std::uint64_t frames_sent() const { return frames_sent_; }
  std::uint64_t frames_dropped() const { return frames_dropped_; }
  bool is_behind() const { return !queue_.empty(); }

 private:
  struct Queued {
    SharedFramePtr frame;
    std::uint32_t dropped_before = 0;
  };
  /// The message that is going out.
  struct Outgoing {
    SharedFramePtr frame;                       ///< a frame, or
    std::string own;                            ///< answers, or
    std::shared_ptr<const std::string> shared;  ///< a status
    FrameEnvelope around;
    Level level = Level::presence;
    std::size_t taken = 0;
  };

  void read_requests(SteadyTime now);
  void choose_format();
  std::optional<ByteView> next_request();
  void handle(ByteView request, SteadyTime now);
  bool within_rate(SteadyTime now);
  void carry_out(const Subscription& asked);
  void carry_out(const Unsubscription&);
  void carry_out(const Ping& ping);
  void carry_out(const Bye&);
  void answer(const std::string& message);
  void refuse_for_good(const WireError& error);
  void grant(const Subscription& asked);
  bool is_thinned_out(const PoseFrame& frame);
  void make_room();
  bool start_next();
  Parts outgoing_parts() const;

  StreamLimits limits_;
  std::optional<Format> format_;
  std::string input_;
  std::size_t input_used_ = 0;
  double request_tokens_ = kMaxRequestsPerSecond;
  SteadyTime tokens_at_, progress_at_;
  Subscription granted_;
  std::int64_t due_ns_ = 0;  ///< thinning: on the frames' steady clock
  std::deque<Queued> queue_;
  std::uint32_t lost_ = 0;  ///< not yet told
  std::string answers_, bye_;
  std::shared_ptr<const std::string> status_;
  bool status_requested_ = false;
  std::optional<Outgoing> outgoing_;
  bool closing_ = false, dead_ = false;
  std::uint64_t frames_sent_ = 0, frames_dropped_ = 0;
};

}  // namespace csipose
