#include "proto/wire.h"

#include <fmt/format.h>
#include <google/protobuf/descriptor.pb.h>
#include <google/protobuf/stubs/logging.h>

#include <algorithm>
#include <cmath>
#include <cstring>

#include "proto/csipose.pb.h"
#include "proto/wire_json.h"

namespace csipose {
namespace {

static_assert(static_cast<int>(Reason::unknown_installation) == v1::UNKNOWN_INSTALLATION,
              "reasons have one numbering");
static_assert(static_cast<int>(State::fault) == v1::FAULT, "states have one numbering");
static_assert(static_cast<int>(Source::simulated) == v1::SIMULATED, "sources have one numbering");
static_assert(static_cast<int>(Level::raw) == v1::RAW, "levels have one numbering");
static_assert(static_cast<int>(OnFull::close) == v1::CLOSE, "back-pressure has one numbering");

template <class ProtobufEnum>
std::string_view lower_case(ProtobufEnum value) {
  // Names live in the descriptors; lower case is made once per value.
  static const auto names = [] {
    std::array<std::string, 16> made;
    const auto& type = *google::protobuf::GetEnumDescriptor<ProtobufEnum>();
    for (int i = 0; i < type.value_count(); ++i)
      made.at(static_cast<std::size_t>(type.value(i)->number())) = json_enum_name(*type.value(i));
    return made;
  }();
  const auto number = static_cast<std::size_t>(value);
  return number < names.size() && !names[number].empty() ? std::string_view(names[number]) : "unknown";
}

/// Protobuf tells malformed text on stderr unless asked not to; what a stranger sends is for counters and
/// errors.
void silence_protobuf() {
  [[maybe_unused]] static auto* const previous = google::protobuf::SetLogHandler(nullptr);
}

// ---- Framing ----

std::string frame(const google::protobuf::Message& message) {
  const std::size_t size = message.ByteSizeLong();
  std::string bytes(4 + size, '\0');
  store_le(reinterpret_cast<std::uint8_t*>(bytes.data()), static_cast<std::uint32_t>(size));
  message.SerializeWithCachedSizesToArray(reinterpret_cast<std::uint8_t*>(bytes.data()) + 4);
  return bytes;
}

/// A message with one oneof as a JSON line: the member's name is the type.
template <class Message>
std::string json_line(const Message& message) {
  const auto* member =
      message.GetReflection()->GetOneofFieldDescriptor(message, message.GetDescriptor()->oneof_decl(0));
  std::string line = "{\"type\":\"" + member->name() + '"', fields;
  append_json_fields(message.GetReflection()->GetMessage(message, member), fields);
  if (!fields.empty()) line += ',' + fields;
  return line + "}\n";
}

template <class Message>
std::string with_framing(Format format, const Message& message) {
  return format == Format::json ? json_line(message) : frame(message);
}

// ---- Frames ----

void put_points(const Skeleton& joints, google::protobuf::RepeatedField<float>& out) {
  for (const Point3& p : joints) out.Add(p.x), out.Add(p.y), out.Add(p.z);
}

void put_person(const Person& person, Level level, bool smoothed, v1::Person& out) {
  const Point3 root = person.root();
  out.set_id(person.id);
  out.set_score(person.score);
  for (const float x : {root.x, root.y, root.z}) out.add_root_m(x);
  if (level == Level::position) return;
  put_points(person.joints, *out.mutable_joints());
  if (smoothed) put_points(person.joints_raw, *out.mutable_joints_raw());
  out.mutable_confidence()->Add(person.confidence.begin(), person.confidence.end());
  out.mutable_sigma_m()->Add(person.sigma_m.begin(), person.sigma_m.end());
  out.set_age_ms(person.age_ms);
}

void put_quality(const ReceiverQuality& quality, Level level, const std::string& id, v1::RxQuality& out) {
  out.set_id(id);
  out.set_rate_hz(quality.rate_hz);
  out.set_missing_ratio(quality.missing_ratio);
  out.set_last_counter(quality.last_counter);
  if (level >= Level::pose) out.mutable_rssi_dbm()->Add(quality.rssi_dbm.begin(), quality.rssi_dbm.end());
}

template <class Add>
void for_each_reason(Reasons reasons, const Add& add) {
  for (int i = 1; i < v1::Reason_ARRAYSIZE; ++i)
    if (reasons >> i & 1U) add(static_cast<v1::Reason>(i));
}

void put_times(const PoseFrame& frame, v1::PoseFrame& out) {
  out.set_t_window_start(static_cast<std::uint64_t>(ns(frame.window_start)));
  out.set_t_window_end(static_cast<std::uint64_t>(ns(frame.window_end)));
  out.set_t_publish(static_cast<std::uint64_t>(ns(frame.published)));
  out.set_mono_ns(static_cast<std::uint64_t>(frame.mono_ns));
  out.set_clock_error_ns(frame.clock_error_ns);
}

void put_frame(const PoseFrame& frame, Level level, const std::vector<std::string>& ids, v1::PoseFrame& out) {
  out.Clear();  // keeps the memory of people and arrays
  out.set_seq(frame.seq);
  out.set_session(frame.session);
  put_times(frame, out);
  out.set_source(static_cast<v1::Source>(frame.source));
  out.set_state(static_cast<v1::State>(frame.state));
  for_each_reason(frame.reasons, [&](v1::Reason reason) { out.add_reasons(reason); });
  out.mutable_model()->assign(frame.model.data(), strnlen(frame.model.data(), frame.model.size()));
  out.set_untrained(frame.untrained);
  out.set_people_count(frame.people_count);
  out.mutable_latency_us()->Add(frame.latency_us.begin(), frame.latency_us.end());
  for (std::size_t r = 0; r < ids.size(); ++r)
    put_quality(frame.receivers[r], level, ids[r], *out.add_quality());
  if (level == Level::presence) return;
  assert(frame.people_count <= kMaxPeople);
  for (std::size_t p = 0; p < frame.people_count; ++p)
    put_person(frame.people[p], level, frame.smoothed, *out.add_people());
}

/// Whether all parts were whole; every one has been read, as arguments are.
bool all(std::initializer_list<bool> parts) {
  return std::find(parts.begin(), parts.end(), false) == parts.end();
}

/// Fixed arrays are there whole or not at all; anything else is a broken message.
template <class Values, class Array>
bool get_array(const Values& from, Array& to, typename Array::value_type absent) {
  to.fill(absent);
  if (from.empty()) return true;
  if (static_cast<std::size_t>(from.size()) != to.size()) return false;
  std::copy(from.begin(), from.end(), to.begin());
  return true;
}

bool get_points(const google::protobuf::RepeatedField<float>& from, Skeleton& to) {
  std::array<float, kPoseWidth> flat;
  const bool whole = get_array(from, flat, kUnknown);
  for (std::size_t j = 0; j < kJoints; ++j) to[j] = {flat[3 * j], flat[3 * j + 1], flat[3 * j + 2]};
  return whole;
}

bool get_person(const v1::Person& from, Person& to, Point3& root) {
  std::array<float, 3> at;
  to.id = from.id();
  to.score = from.score();
  to.age_ms = from.age_ms();
  const bool whole = all({get_array(from.root_m(), at, kUnknown), get_points(from.joints(), to.joints),
                          get_points(from.joints_raw(), to.joints_raw),
                          get_array(from.confidence(), to.confidence, kUnknown),
                          get_array(from.sigma_m(), to.sigma_m, kUnknown)});
  root = {at[0], at[1], at[2]};
  return whole;
}

bool get_quality(const v1::RxQuality& from, ReceiverQuality& to) {
  to.rate_hz = from.rate_hz();
  to.missing_ratio = from.missing_ratio();
  to.last_counter = from.last_counter();
  return get_array(from.rssi_dbm(), to.rssi_dbm, kUnknown);
}

template <class Values>
Reasons get_reasons(const Values& from) {
  Reasons reasons = 0;
  for (const int reason : from)
    if (reason > 0 && reason < 32) reasons |= Reasons{1} << reason;
  return reasons;
}

Nanoseconds since_epoch(std::uint64_t t) { return Nanoseconds{static_cast<std::int64_t>(t)}; }

bool get_people(const v1::PoseFrame& from, ReceivedPose& to) {
  if (static_cast<std::size_t>(from.people_size()) > kMaxPeople) return false;
  if (from.people_count() > kMaxPeople) return false;
  bool whole = true;
  to.frame.people_count = from.people_count();
  for (int p = 0; p < from.people_size(); ++p) {
    const auto i = static_cast<std::size_t>(p);
    whole &= get_person(from.people(p), to.frame.people[i], to.root_m[i]);
    to.frame.smoothed |= from.people(p).joints_raw_size() > 0;
  }
  to.people_described = static_cast<std::uint32_t>(from.people_size());
  return whole;
}

void get_head(const v1::PoseFrame& from, PoseFrame& to) {
  to.seq = from.seq();
  to.session = from.session();
  to.window_start = UtcTime{since_epoch(from.t_window_start())};
  to.window_end = UtcTime{since_epoch(from.t_window_end())};
  to.published = UtcTime{since_epoch(from.t_publish())};
  to.mono_ns = static_cast<std::int64_t>(from.mono_ns());
  to.clock_error_ns = from.clock_error_ns();
  to.source = static_cast<Source>(from.source());
  to.state = static_cast<State>(from.state());
  to.reasons = get_reasons(from.reasons());
  from.model().copy(to.model.data(), to.model.size());
  to.untrained = from.untrained();
}

Result<ServerMessage, WireError> broken(const char* what) {
  return WireError{"bad_message", std::string("The server's message is broken: ") + what + ".",
                   "Check that client and daemon are of one version."};
}

Result<ServerMessage, WireError> to_plain(const v1::PoseFrame& from) {
  ReceivedPose pose;
  get_head(from, pose.frame);
  pose.dropped_before = from.dropped_before();
  bool whole = all({get_people(from, pose), get_array(from.latency_us(), pose.frame.latency_us, 0U)});
  whole &= static_cast<std::size_t>(from.quality_size()) <= kReceivers;
  for (int r = 0; whole && r < from.quality_size(); ++r)
    whole = get_quality(from.quality(r), pose.frame.receivers[static_cast<std::size_t>(r)]);
  if (!whole) return broken("a frame with arrays of the wrong size");
  return ServerMessage{pose};
}

// ---- Status ----

template <class List>
void put_counts(const std::vector<NamedCount>& counts, List& out) {
  for (const NamedCount& count : counts) {
    auto& added = *out.Add();
    added.set_name(count.name);
    added.set_count(count.count);
  }
}

void put_receiver(const ReceiverStatus& rx, v1::ReceiverStatus& out) {
  out.set_id(rx.id);
  out.set_present(rx.present);
  out.set_rate_hz(rx.rate_hz);
  out.mutable_rssi_dbm()->Add(rx.rssi_dbm.begin(), rx.rssi_dbm.end());
  out.set_last_packet_ns(static_cast<std::uint64_t>(ns(rx.last_packet)));
  out.set_packets(rx.packets);
  out.set_usable(rx.usable);
  out.set_lost(rx.lost);
  out.set_filled(rx.filled);
  put_counts(rx.rejected, *out.mutable_rejected());
  out.set_offset_s(rx.offset_s);
  out.set_skew_ppm(rx.skew_ppm);
  out.set_residual_s(rx.residual_s);
  out.set_match_ratio(rx.match_ratio);
  out.set_clock_error_ns(rx.clock_error_ns);
  out.set_clock_epochs(rx.clock_epochs);
}

void put_latency(const StageStatus& stage, v1::Latency& out) {
  out.set_stage(stage.name);
  out.set_count(stage.histogram.count());
  out.set_p50_ms(stage.histogram.quantile_us(0.5) / 1000);
  out.set_p99_ms(stage.histogram.quantile_us(0.99) / 1000);
  out.set_p999_ms(stage.histogram.quantile_us(0.999) / 1000);
  out.set_max_ms(stage.histogram.max_us() / 1000.0);
}

void put_client(const ClientStatus& client, v1::ClientStatus& out) {
  out.set_name(client.name);
  out.set_level(static_cast<v1::Level>(client.level));
  out.set_sent(client.sent);
  out.set_dropped(client.dropped);
}

void put_recording(const RecordingStatus& recording, v1::RecordingStatus& out) {
  out.set_active(recording.active);
  out.set_file(recording.file);
  out.set_bytes(recording.bytes);
  out.set_errors(recording.errors);
}

void put_identity(const Status& status, v1::Status& out) {
  out.set_name(status.name);
  out.set_version(status.version);
  out.set_commit(status.commit);
  out.set_session(status.session);
  out.set_uptime_s(status.uptime_s);
  out.set_source(static_cast<v1::Source>(status.source));
  out.set_source_text(status.source_text);
  out.set_model(status.model);
  out.set_model_path(status.model_path);
  out.set_model_text(status.model_text);
  out.set_untrained(status.untrained);
  out.set_engine(status.engine);
  out.set_config_path(status.config_path);
}

void put_status(const Status& status, v1::Status& out) {
  put_identity(status, out);
  out.set_state(static_cast<v1::State>(status.state));
  for_each_reason(status.reasons, [&](v1::Reason reason) { out.add_reasons(reason); });
  out.set_budget_ms(status.budget_ms);
  out.set_transmit_hz(status.transmit_hz);
  out.set_people(status.people);
  out.set_frames_published(status.frames_published);
  out.set_deadline_misses(status.deadline_misses);
  put_counts(status.windows, *out.mutable_windows());
  for (const auto& rx : status.receivers) put_receiver(rx, *out.add_receivers());
  for (const auto& stage : status.stages) put_latency(stage, *out.add_latency());
  for (const auto& client : status.clients) put_client(client, *out.add_clients());
  out.set_client_dropped_frames(status.client_dropped_frames);
  out.set_ring_dropped_frames(status.ring_dropped_frames);
  put_counts(status.auth_failures, *out.mutable_auth_failures());
  put_counts(status.config_reloads, *out.mutable_config_reloads());
  put_recording(status.recording, *out.mutable_recording());
  out.set_watchdog_pings(status.watchdog_pings);
}

template <class List>
std::vector<NamedCount> get_counts(const List& from) {
  std::vector<NamedCount> counts;
  for (const auto& count : from) counts.push_back({count.name(), count.count()});
  return counts;
}

ReceiverStatus get_receiver(const v1::ReceiverStatus& from) {
  ReceiverStatus rx;
  rx.id = from.id();
  rx.present = from.present();
  rx.rate_hz = from.rate_hz();
  (void)get_array(from.rssi_dbm(), rx.rssi_dbm, kUnknown);  // another count of antennas: not told
  rx.last_packet = UtcTime{since_epoch(from.last_packet_ns())};
  rx.packets = from.packets();
  rx.usable = from.usable();
  rx.lost = from.lost();
  rx.filled = from.filled();
  rx.rejected = get_counts(from.rejected());
  rx.offset_s = from.offset_s();
  rx.skew_ppm = from.skew_ppm();
  rx.residual_s = from.residual_s();
  rx.match_ratio = from.match_ratio();
  rx.clock_error_ns = from.clock_error_ns();
  rx.clock_epochs = from.clock_epochs();
  return rx;
}

void get_identity(const v1::Status& from, Status& to) {
  to.name = from.name();
  to.version = from.version();
  to.commit = from.commit();
  to.session = from.session();
  to.uptime_s = from.uptime_s();
  to.source = static_cast<Source>(from.source());
  to.source_text = from.source_text();
  to.model = from.model();
  to.model_path = from.model_path();
  to.model_text = from.model_text();
  to.untrained = from.untrained();
  to.engine = from.engine();
  to.config_path = from.config_path();
}

void get_counters(const v1::Status& from, Status& to) {
  to.people = from.people();
  to.frames_published = from.frames_published();
  to.deadline_misses = from.deadline_misses();
  to.windows = get_counts(from.windows());
  to.client_dropped_frames = from.client_dropped_frames();
  to.ring_dropped_frames = from.ring_dropped_frames();
  to.auth_failures = get_counts(from.auth_failures());
  to.config_reloads = get_counts(from.config_reloads());
  to.watchdog_pings = from.watchdog_pings();
}

Result<ServerMessage, WireError> to_plain(const v1::Status& from) {
  ReceivedStatus to;
  get_identity(from, to.status);
  get_counters(from, to.status);
  to.status.state = static_cast<State>(from.state());
  to.status.reasons = get_reasons(from.reasons());
  to.status.budget_ms = from.budget_ms();
  to.status.transmit_hz = from.transmit_hz();
  for (const auto& rx : from.receivers()) to.status.receivers.push_back(get_receiver(rx));
  for (const auto& client : from.clients())
    to.status.clients.push_back(
        {client.name(), static_cast<Level>(client.level()), client.sent(), client.dropped()});
  to.status.recording = {from.recording().active(), from.recording().file(), from.recording().bytes(),
                         from.recording().errors()};
  for (const auto& l : from.latency())
    to.latency.push_back({l.stage(), l.count(), l.p50_ms(), l.p99_ms(), l.p999_ms(), l.max_ms()});
  return ServerMessage{to};
}

// ---- Hello, subscription and small talk ----

void put_skeleton(v1::Skeleton& out) {
  for (const auto name : kJointNames) out.add_names(std::string(name));
  for (const auto& bone : kBones) out.add_bones(bone[0]), out.add_bones(bone[1]);
}

void put_room(const RoomDescription& room, v1::Room& out) {
  out.mutable_size_m()->Add(room.size_m.begin(), room.size_m.end());
  out.mutable_transmitter_m()->Add(room.transmitter_m.begin(), room.transmitter_m.end());
  for (const Placed& receiver : room.receivers) {
    auto& placed = *out.add_receivers();
    placed.set_id(receiver.id);
    placed.mutable_position_m()->Add(receiver.position_m.begin(), receiver.position_m.end());
  }
}

void put_hello(const Hello& hello, v1::Hello& out) {
  out.set_api(hello.api);
  out.set_name(hello.name);
  out.set_session(hello.session);
  out.set_source(static_cast<v1::Source>(hello.source));
  out.set_state(static_cast<v1::State>(hello.state));
  out.set_model(hello.model);
  out.set_untrained(hello.untrained);
  put_skeleton(*out.mutable_skeleton());
  put_room(hello.room, *out.mutable_room());
  out.set_level(static_cast<v1::Level>(hello.level));
  out.mutable_rates_hz()->set_samples(hello.sample_hz);
  out.mutable_rates_hz()->set_poses(hello.pose_hz);
  out.set_budget_ms(hello.budget_ms);
  out.set_clock(hello.clock);
}

bool get_room(const v1::Room& from, RoomDescription& to) {
  bool whole =
      all({get_array(from.size_m(), to.size_m, 0.F), get_array(from.transmitter_m(), to.transmitter_m, 0.F)});
  for (const auto& receiver : from.receivers()) {
    to.receivers.push_back({receiver.id(), {}});
    whole &= get_array(receiver.position_m(), to.receivers.back().position_m, 0.F);
  }
  return whole;
}

Result<ServerMessage, WireError> to_plain(const v1::Hello& from) {
  Hello to;
  to.api = from.api();
  to.name = from.name();
  to.session = from.session();
  to.source = static_cast<Source>(from.source());
  to.state = static_cast<State>(from.state());
  to.model = from.model();
  to.untrained = from.untrained();
  if (!get_room(from.room(), to.room)) return broken("a room whose points are not three numbers");
  to.level = static_cast<Level>(from.level());
  to.sample_hz = from.rates_hz().samples();
  to.pose_hz = from.rates_hz().poses();
  to.budget_ms = from.budget_ms();
  to.clock = from.clock();
  return ServerMessage{to};
}

/// Subscribe and Subscribed have the same fields.
template <class Message>
void put_subscription(const Subscription& subscription, Message& out) {
  if (subscription.pose) out.add_what(v1::Subscribe::POSE);
  if (subscription.status) out.add_what(v1::Subscribe::STATUS);
  out.set_level(static_cast<v1::Level>(subscription.level));
  out.set_max_hz(subscription.max_hz);
  out.set_queue(subscription.queue);
  out.set_on_full(static_cast<v1::OnFull>(subscription.on_full));
}

template <class Message>
Subscription get_subscription(const Message& from) {
  Subscription to;
  for (const int topic : from.what()) (topic == v1::Subscribe::POSE ? to.pose : to.status) = true;
  if (from.level() != v1::LEVEL_UNSPECIFIED) to.level = static_cast<Level>(from.level());
  to.max_hz = from.max_hz();
  to.queue = from.queue();
  if (from.on_full() != v1::ON_FULL_UNSPECIFIED) to.on_full = static_cast<OnFull>(from.on_full());
  return to;
}

/// JSON cannot say these; protobuf keeps numbers of enums that it does not know.
std::optional<WireError> check(const v1::Subscribe& subscribe) {
  const auto error = [](const char* key, const char* remedy) {
    return WireError{"bad_value", fmt::format("\"{}\" has a value that means nothing here.", key), remedy};
  };
  for (const int topic : subscribe.what())
    if (!v1::Subscribe::Topic_IsValid(topic) || topic == 0)
      return error("what", "Name pose, status or both.");
  if (subscribe.what().empty()) return error("what", "Name pose, status or both.");
  if (!v1::Level_IsValid(subscribe.level()))
    return error("level", "Ask for presence, position, pose or raw.");
  if (!v1::OnFull_IsValid(subscribe.on_full()))
    return error("on_full", "Choose drop_oldest, latest or close.");
  if (!std::isfinite(subscribe.max_hz()) || subscribe.max_hz() < 0)
    return error("max_hz", "Give a rate above 0, or 0 for every frame.");
  return std::nullopt;
}

Result<ClientMessage, WireError> to_plain(const v1::ClientMessage& from) {
  switch (from.message_case()) {
    case v1::ClientMessage::kSubscribe:
      if (auto error = check(from.subscribe())) return *error;
      return ClientMessage{get_subscription(from.subscribe())};
    case v1::ClientMessage::kUnsubscribe:
      return ClientMessage{Unsubscription{}};
    case v1::ClientMessage::kPing:
      return ClientMessage{Ping{from.ping().id()}};
    case v1::ClientMessage::kBye:
      return ClientMessage{Bye{from.bye().reason()}};
    case v1::ClientMessage::MESSAGE_NOT_SET:
      break;
  }
  return WireError{"unknown_type", "The message asks for nothing that is known here.",
                   "Send subscribe, unsubscribe, ping or bye."};
}

Result<ServerMessage, WireError> to_plain(const v1::ServerMessage& from) {
  switch (from.message_case()) {
    case v1::ServerMessage::kHello:
      return to_plain(from.hello());
    case v1::ServerMessage::kSubscribed:
      return ServerMessage{Subscribed{get_subscription(from.subscribed())}};
    case v1::ServerMessage::kError:
      return ServerMessage{WireError{from.error().code(), from.error().text(), from.error().remedy()}};
    case v1::ServerMessage::kPose:
      return to_plain(from.pose());
    case v1::ServerMessage::kStatus:
      return to_plain(from.status());
    case v1::ServerMessage::kPong:
      return ServerMessage{Pong{from.pong().id()}};
    case v1::ServerMessage::kBye:
      return ServerMessage{Bye{from.bye().reason()}};
    case v1::ServerMessage::MESSAGE_NOT_SET:
      break;
  }
  return broken("it says nothing that is known here");
}

template <class Message>
std::optional<WireError> read(Format format, ByteView bytes, bool strict, Message& message) {
  silence_protobuf();
  if (format == Format::json) return read_typed_json(bytes, strict, message);
  if (message.ParseFromArray(bytes.data(), static_cast<int>(bytes.size()))) return std::nullopt;
  return WireError{"bad_protobuf", fmt::format("The {} bytes are no csipose.v1 message.", bytes.size()),
                   "Send a u32 little-endian length, then that many bytes of a message of csipose.proto."};
}

void put(const Subscription& subscription, v1::ClientMessage& out) {
  put_subscription(subscription, *out.mutable_subscribe());
}
void put(const Unsubscription&, v1::ClientMessage& out) { out.mutable_unsubscribe(); }
void put(const Ping& ping, v1::ClientMessage& out) { out.mutable_ping()->set_id(ping.id); }
void put(const Bye& bye, v1::ClientMessage& out) { out.mutable_bye()->set_reason(bye.reason); }

}  // namespace

std::string_view name_of(Source source) { return lower_case(static_cast<v1::Source>(source)); }
std::string_view name_of(State state) { return lower_case(static_cast<v1::State>(state)); }
std::string_view name_of(Reason reason) { return lower_case(static_cast<v1::Reason>(reason)); }
std::string_view name_of(Level level) { return lower_case(static_cast<v1::Level>(level)); }
std::string_view name_of(OnFull on_full) { return lower_case(static_cast<v1::OnFull>(on_full)); }

std::string names_of(Reasons reasons) {
  std::string names;
  for_each_reason(reasons, [&](v1::Reason reason) {
    if (!names.empty()) names += ", ";
    names += lower_case(reason);
  });
  return names;
}

Result<ClientMessage, WireError> parse_client_message(Format format, ByteView bytes) {
  v1::ClientMessage message;
  if (auto error = read(format, bytes, /*strict=*/true, message)) return *error;
  return to_plain(message);
}

Result<ServerMessage, WireError> parse_server_message(Format format, ByteView bytes) {
  v1::ServerMessage message;
  if (auto error = read(format, bytes, /*strict=*/false, message)) return *error;
  return to_plain(message);
}

std::string encode(Format format, const ClientMessage& message) {
  v1::ClientMessage out;
  std::visit([&](const auto& said) { put(said, out); }, message);
  return with_framing(format, out);
}

std::string encode(Format format, const Hello& hello) {
  v1::ServerMessage out;
  put_hello(hello, *out.mutable_hello());
  return with_framing(format, out);
}

std::string encode(Format format, const Subscribed& subscribed) {
  v1::ServerMessage out;
  put_subscription(subscribed.granted, *out.mutable_subscribed());
  return with_framing(format, out);
}

std::string encode(Format format, const WireError& error) {
  v1::ServerMessage out;
  out.mutable_error()->set_code(error.code);
  out.mutable_error()->set_text(error.text);
  out.mutable_error()->set_remedy(error.remedy);
  return with_framing(format, out);
}

std::string encode(Format format, const Status& status) {
  v1::ServerMessage out;
  put_status(status, *out.mutable_status());
  return with_framing(format, out);
}

std::string encode(Format format, const Pong& pong) {
  v1::ServerMessage out;
  out.mutable_pong()->set_id(pong.id);
  return with_framing(format, out);
}

std::string encode(Format format, const Bye& bye) {
  v1::ServerMessage out;
  out.mutable_bye()->set_reason(bye.reason);
  return with_framing(format, out);
}

struct FrameEncoder::Buffers {
  std::vector<std::string> receiver_ids;
  v1::PoseFrame message;
};

FrameEncoder::FrameEncoder(std::vector<std::string> receiver_ids) : buffers_(std::make_unique<Buffers>()) {
  assert(receiver_ids.size() <= kReceivers);
  buffers_->receiver_ids = std::move(receiver_ids);
}
FrameEncoder::~FrameEncoder() = default;

void FrameEncoder::encode_body(const PoseFrame& frame, Level level, Format format, std::string& out) {
  put_frame(frame, std::min(level, Level::pose), buffers_->receiver_ids, buffers_->message);
  if (format == Format::protobuf) {
    buffers_->message.SerializeToString(&out);
    return;
  }
  out = "{\"type\":\"pose\",";
  append_json_fields(buffers_->message, out);
}

namespace {
/// A protobuf varint: seven bits a byte, least significant first, the top bit says that more follow.
std::size_t put_varint(std::uint32_t value, char* out) {
  std::size_t size = 0;
  for (; value >= 0x80; value >>= 7) out[size++] = static_cast<char>(value | 0x80);
  out[size++] = static_cast<char>(value);
  return size;
}
constexpr std::uint32_t length_delimited_tag(int field) { return static_cast<std::uint32_t>(field) << 3 | 2; }
constexpr std::uint32_t varint_tag(int field) { return static_cast<std::uint32_t>(field) << 3; }
}  // namespace

FrameEnvelope envelope(Format format, std::size_t body_size, std::uint32_t dropped_before) {
  FrameEnvelope made;
  if (format == Format::json) {
    const auto end =
        fmt::format_to_n(made.tail.data(), made.tail.size(), ",\"dropped_before\":{}}}\n", dropped_before);
    made.tail_size = end.size;
    return made;
  }
  if (dropped_before > 0) {  // fields of a message may stand in any order: this one goes last
    made.tail_size = put_varint(varint_tag(v1::PoseFrame::kDroppedBeforeFieldNumber), made.tail.data());
    made.tail_size += put_varint(dropped_before, made.tail.data() + made.tail_size);
  }
  std::size_t at =
      4 + put_varint(length_delimited_tag(v1::ServerMessage::kPoseFieldNumber), made.head.data() + 4);
  at += put_varint(static_cast<std::uint32_t>(body_size + made.tail_size), made.head.data() + at);
  made.head_size = at;
  store_le(reinterpret_cast<std::uint8_t*>(made.head.data()),
           static_cast<std::uint32_t>(at - 4 + body_size + made.tail_size));
  return made;
}

std::string pose_schema() {
  google::protobuf::FileDescriptorSet set;
  v1::PoseFrame::descriptor()->file()->CopyTo(set.add_file());
  return set.SerializeAsString();
}

}  // namespace csipose
