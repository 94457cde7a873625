#include "daemon/config.h"

namespace csipose {
namespace {

constexpr auto R = Change::reload;
constexpr auto S = Change::restart;
constexpr double kFar = 1000;  // metres; no room is larger

Allowed any() { return {}; }
Allowed from(double min, double max) { return {min, max, {}}; }
Allowed one_of(std::vector<std::string_view> words) { return {0, 0, std::move(words)}; }

#define FIELD(member) [](auto& owner) -> Field { return &owner.member; }

const std::vector<Key<Config>>& table() {
  static const std::vector<Key<Config>> keys = {
      {"daemon.name", FIELD(daemon.name), any(), S, "shown to clients"},
      {"daemon.log_level", FIELD(daemon.log_level), one_of({"error", "warn", "info", "debug"}), R,
       "the least urgent kind of line that is logged"},
      {"daemon.state_dir", FIELD(daemon.state_dir), any(), S, "what is kept: recordings"},
      {"daemon.run_dir", FIELD(daemon.run_dir), any(), S, "where the sockets are made"},

      {"room.size_m", FIELD(room.size_m), from(0, kFar), S,
       "room frame: right-handed, metres, x along one wall, y into the room, z up, origin at a floor corner; "
       "told to clients"},
      {"room.transmitter_m", FIELD(room.transmitter_m), from(-kFar, kFar), S,
       "where the transmitter stands; told to clients"},

      {"source.kind", FIELD(source.kind), one_of({"agents", "file"}), S,
       "agents = live, by the door of each [[receiver]]; file = replay of source.files"},
      {"source.files", FIELD(source.files), any(), S,
       "for kind = file: one .mcap, or one to three csitool .dat files (one is given to all three "
       "receivers)"},
      {"source.speed", FIELD(source.speed), from(0, 1000), S,
       "replay speed; 1 = as recorded, 0 = as fast as possible, and then nothing is dropped"},
      {"source.loop", FIELD(source.loop), any(), S, "start the replay again at its end"},
      {"source.rate_hz", FIELD(source.rate_hz), from(0, 10000), S,
       "for .dat files whose NIC clock is unusable: packets a second; 0 = use the clock"},
      {"source.wait_clients", FIELD(source.wait_clients), from(0, 64), S,
       "a replay starts when so many clients have subscribed"},

      {"ingest.listen", FIELD(ingest.listen), any(), S,
       "udp://address:port for agents' datagrams; ignored when systemd hands over a socket"},
      {"ingest.listen_tcp", FIELD(ingest.listen_tcp), any(), S,
       "tcp://address:port for csitool's log_to_server, unencrypted; only receivers with peer and insecure = "
       "true "
       "may connect; empty = off"},
      {"ingest.counter", FIELD(ingest.counter),
       one_of({"automatic", "csip", "sequence16", "lfsr", "sequence12", "none"}), S,
       "how the transmit counter is read from a received frame"},
      {"ingest.align", FIELD(ingest.align), one_of({"tx_counter", "time"}), S,
       "how frames of different receivers are joined; a receiver without counter is joined by time in any "
       "case"},
      {"ingest.tx_rate_hz", FIELD(ingest.tx_rate_hz), from(0, 10000), S, "transmit rate; 0 = measured"},
      {"ingest.max_skew_ms", FIELD(ingest.max_skew_ms), from(1, 1000), S,
       "receivers further apart than this are reported (reason SKEW)"},
      {"ingest.stale_after_ms", FIELD(ingest.stale_after_ms), from(50, 60000), S,
       "no packet for so long: state STALE, tracks are forgotten"},

      {"ingest.session_ttl_s", FIELD(ingest.session_ttl_s), from(60, 86400), S,
       "how long an agent's session lasts; it renews it in time"},
      {"ingest.max_pps_per_receiver", FIELD(ingest.max_pps_per_receiver), from(10, 100000), S,
       "datagrams of one agent beyond this rate are refused and counted"},

      {"window.hop", FIELD(window.hop), from(1, 20), S, "a new window, and pose, every so many samples"},
      {"window.sample_rate_hz", FIELD(window.sample_rate_hz), from(10, 5000), S,
       "the grid; must be the rate that the model file states"},
      {"window.max_gap", FIELD(window.max_gap), from(0, 19), S,
       "a lost sample is filled from at most so many samples before; further back the receiver is masked"},
      {"window.stream", FIELD(window.stream), from(0, 2), S, "which space-time stream is used"},

      {"sanitise.phase", FIELD(sanitise.phase), one_of({"joint", "phasefi"}), S,
       "must be what the model file states"},
      {"sanitise.amplitude", FIELD(sanitise.amplitude), one_of({"raw", "scaled"}), S,
       "must be what the model file states"},
      {"sanitise.antenna_permutation", FIELD(sanitise.antenna_permutation), one_of({"undo", "keep"}), S,
       "chains are put in the order of antennas A, B, C"},
      {"sanitise.rotation_40mhz", FIELD(sanitise.rotation_40mhz), one_of({"undo", "keep"}), S,
       "the standard's +90 degrees on the upper half of a 40 MHz channel"},

      {"model.path", FIELD(model.path), any(), S, "weights (.safetensors)"},
      {"model.sha256", FIELD(model.sha256), any(), S,
       "digest that the weights must have; empty = any, the log names it"},
      {"model.engine", FIELD(model.engine), one_of({"onednn", "reference"}), S,
       "reference = plain loops, slow, for comparisons"},
      {"model.precision", FIELD(model.precision), one_of({"auto", "f32", "bf16", "int8"}), S,
       "auto = the fastest that the processor has and the model's accuracy gate allows"},
      {"model.threads", FIELD(model.threads), from(1, 64), S, "threads of the network"},

      {"loop.jitter_ms", FIELD(loop.jitter_ms), from(0, 1000), S, "how long a window waits for stragglers"},
      {"loop.budget_ms", FIELD(loop.budget_ms), from(1, 1000), S,
       "constant delay from a window's last sample to its publication; later results are dropped and "
       "counted"},
      {"loop.cpu_affinity", FIELD(loop.cpu_affinity), from(0, 1023), S,
       "processors of the loop and the network's threads, one each; empty = not pinned"},
      {"loop.realtime_priority", FIELD(loop.realtime_priority), from(0, 99), S,
       "SCHED_FIFO priority of the loop; 0 = ordinary"},
      {"loop.lock_memory", FIELD(loop.lock_memory), any(), S, "keep all memory resident"},

      {"people.max", FIELD(people.max), from(1, 10), S, "at most so many people in a frame"},
      {"people.min_score", FIELD(people.min_score), from(0, 1), R, "a person below this score is not sent"},
      {"people.nms_distance_m", FIELD(people.nms_distance_m), from(0, 10), R,
       "of two poses nearer than this on average, the lower-scored is dropped"},
      {"people.track", FIELD(people.track), any(), R, "stable ids over time"},
      {"people.track_timeout_ms", FIELD(people.track_timeout_ms), from(0, 60000), R,
       "a track not seen for so long ends"},
      {"people.score_memory_ms", FIELD(people.score_memory_ms), from(0, 60000), R,
       "a tracked person's score is the mean over about so long, where windows without the person count as "
       "0; 0 = of each window alone"},
      {"people.smoothing", FIELD(people.smoothing), one_of({"none", "one_euro"}), R,
       "of joints over time; the joints before smoothing are then in the message too"},

      {"stream.socket", FIELD(stream.socket), any(), S,
       "in run_dir, mode 0660; ignored when systemd hands over a socket"},
      {"stream.control_socket", FIELD(stream.control_socket), any(), S,
       "in run_dir, mode 0660; empty = none"},
      {"stream.max_clients", FIELD(stream.max_clients), from(1, 1024), R, "subscribers at one time"},
      {"stream.queue_frames", FIELD(stream.queue_frames), from(1, 64), R,
       "the most frames that wait for one client"},
      {"stream.idle_close_s", FIELD(stream.idle_close_s), from(1, 3600), R,
       "a client that takes nothing for so long is closed"},

      {"metrics.textfile", FIELD(metrics.textfile), any(), S,
       "Prometheus text, written once a second by atomic rename; empty = none"},

      {"record.enabled", FIELD(record.enabled), any(), R, "record from the start"},
      {"record.dir", FIELD(record.dir), any(), S, "in state_dir"},
      {"record.content", FIELD(record.content), one_of({"csi", "pose"}), S, "what goes into a recording"},
      {"record.rotate_mb", FIELD(record.rotate_mb), from(1, 1048576), S, "a new file after so much"},
      {"record.rotate_min", FIELD(record.rotate_min), from(1, 10080), S, "and after so long"},
      {"record.keep_days", FIELD(record.keep_days), from(0, 36500), S,
       "older recordings are removed; 0 = kept"},
      {"record.keep_total_mb", FIELD(record.keep_total_mb), from(0, 1048576), S,
       "the oldest are removed while all are more than this; 0 = kept"},

      {"privacy.max_level", FIELD(privacy.max_level), one_of({"presence", "position", "pose"}), R,
       "the most that any client is told"},
  };
  return keys;
}

const std::vector<Key<ReceiverConfig>>& receiver_table() {
  static const std::vector<Key<ReceiverConfig>> keys = {
      {"id", FIELD(id), any(), S, "letters, digits, - and _; named in logs, status and recordings"},
      {"position_m", FIELD(position_m), from(-kFar, kFar), S, "in the room frame; told to clients"},
      {"key_file", FIELD(key_file), any(), S, "door 1: an agent with this key, made by `csipose agent add`"},
      {"peer", FIELD(peer), any(), S,
       "door 2: csitool's log_to_server from this address (needs insecure = true)"},
      {"insecure", FIELD(insecure), any(), S,
       "says that unencrypted, unauthenticated data is accepted from peer"},
      {"local", FIELD(local), any(), S, "door 3: the Intel 5300 of this computer, by netlink"},
  };
  return keys;
}
#undef FIELD

}  // namespace

std::span<const Key<Config>> config_keys() { return table(); }
std::span<const Key<ReceiverConfig>> receiver_keys() { return receiver_table(); }

}  // namespace csipose
