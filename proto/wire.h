// proto/wire.h - what travels between the daemon and its subscribers, as protobuf or as JSON lines.
//
// The only door to protobuf: these are plain types, csipose.pb.h is seen by wire*.cpp alone. JSON is made
// from the protobuf messages by their field names, so both formats say the same. The messages are those of
// csipose.proto; docs/stream.md tells them to people.
#pragma once

#include <array>
#include <cstdint>
#include <memory>
#include <string>
#include <string_view>
#include <variant>
#include <vector>

#include "proto/bytes.h"
#include "proto/pose.h"
#include "proto/result.h"
#include "proto/status.h"

namespace csipose {

inline constexpr std::string_view kStreamApi = "1.0";
inline constexpr std::size_t kMaxRequestBytes = 16 * 1024;
inline constexpr std::size_t kMaxServerMessageBytes = 1024 * 1024;  ///< a client refuses what is larger
inline constexpr char kProtobufMark =
    0x01;  ///< first byte from a client that wants protobuf; '{' means JSON lines

enum class Format : std::uint8_t { json, protobuf };
enum class OnFull : std::uint8_t { drop_oldest = 1, latest = 2, close = 3 };

std::string_view name_of(Source source);   ///< "live"
std::string_view name_of(State state);     ///< "tracking"
std::string_view name_of(Reason reason);   ///< "rx_missing"
std::string_view name_of(Level level);     ///< "pose"
std::string_view name_of(OnFull on_full);  ///< "drop_oldest"
/// "rx_missing, gap"; empty when none.
std::string names_of(Reasons reasons);

// ---- What a client says ----

struct Subscription {
  bool pose = false, status = false;
  Level level = Level::raw;  ///< asked: the most wanted; granted: what is sent
  float max_hz = 0;          ///< 0 = every frame
  std::uint32_t queue = 0;   ///< frames; 0 = the server's choice
  OnFull on_full = OnFull::drop_oldest;
};
struct Unsubscription {};
struct Ping {
  std::uint64_t id = 0;
};
struct Bye {
  std::string reason;
};
using ClientMessage = std::variant<Subscription, Unsubscription, Ping, Bye>;

/// What was wrong, with what, and what to do; sent to a client as `error`, and what the parsers below give.
struct WireError {
  std::string code, text, remedy;
};

/// One request, without framing (no length, no newline). Refuses unknown types, keys and values with words.
Result<ClientMessage, WireError> parse_client_message(Format format, ByteView bytes);
/// With framing.
std::string encode(Format format, const ClientMessage& message);

// ---- What the server says ----

struct Placed {
  std::string id;
  std::array<float, 3> position_m{};
};
struct RoomDescription {
  std::array<float, 3> size_m{}, transmitter_m{};
  std::vector<Placed> receivers;
};
struct Hello {
  std::string api{kStreamApi}, name;
  std::uint64_t session = 0;
  Source source = Source::live;
  State state = State::warmup;
  std::string model;  ///< first 12 hex digits of the digest
  bool untrained = false;
  RoomDescription room;
  Level level = Level::pose;  ///< the most that will be granted
  float sample_hz = 0, pose_hz = 0, budget_ms = 0;
  std::string clock = "utc";  ///< or "recording"
};
struct Subscribed {
  Subscription granted;
};
/// A frame as a client gets it: what its level leaves out is 0 or NaN.
struct ReceivedPose {
  PoseFrame frame;                     ///< people_count counts even those that are not described
  std::uint32_t people_described = 0;  ///< 0 at Level::presence
  std::array<Point3, kMaxPeople>
      root_m{};  ///< of the described ones: all there is of their place at Level::position
  std::uint32_t dropped_before = 0;
};
/// A status as a client gets it: histograms have become quantiles.
struct ReceivedStatus {
  struct Latency {
    std::string stage;
    std::uint64_t count = 0;
    double p50_ms = 0, p99_ms = 0, p999_ms = 0, max_ms = 0;
  };
  Status status;
  std::vector<Latency> latency;
};
struct Pong {
  std::uint64_t id = 0;
};
using ServerMessage = std::variant<Hello, Subscribed, WireError, ReceivedPose, ReceivedStatus, Pong, Bye>;

Result<ServerMessage, WireError> parse_server_message(Format format, ByteView bytes);

/// With framing.
std::string encode(Format format, const Hello& hello);
std::string encode(Format format, const Subscribed& subscribed);
std::string encode(Format format, const WireError& error);
std::string encode(Format format, const Status& status);
std::string encode(Format format, const Pong& pong);
std::string encode(Format format, const Bye& bye);

/// Turns frames into bytes. Keeps its buffers: after the first frame of a size nothing is allocated but by
/// growth of `out`. One thread.
class FrameEncoder {
 public:
  /// `receiver_ids` in configured order; RxQuality carries them.
  explicit FrameEncoder(std::vector<std::string> receiver_ids);
  ~FrameEncoder();
  /// The part of a message that all clients of one level and format share: for protobuf a PoseFrame without
  /// dropped_before (this is also what a recording keeps), for JSON the line up to dropped_before. Level::raw
  /// gives what Level::pose gives: CSI is not streamed.
  ///   cost: some 1 us protobuf, 80 us JSON, for a frame of five people; the publisher's thread pays it, not the loop
  void encode_body(const PoseFrame& frame, Level level, Format format, std::string& out);

 private:
  struct Buffers;
  std::unique_ptr<Buffers> buffers_;
};

/// What goes before and after a shared body to make it one client's message. No allocation.
struct FrameEnvelope {
  std::array<char, 32> head{}, tail{};
  std::size_t head_size = 0, tail_size = 0;
};
FrameEnvelope envelope(Format format, std::size_t body_size, std::uint32_t dropped_before);

/// A serialised google.protobuf.FileDescriptorSet that describes csipose.v1.PoseFrame: the schema in
/// recordings.
std::string pose_schema();
inline constexpr std::string_view kPoseSchemaName = "csipose.v1.PoseFrame";

}  // namespace csipose
