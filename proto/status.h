// proto/status.h - how the daemon is doing, as plain numbers: one snapshot for `csipose status`, subscribers
// and Prometheus.
//
// Filled once a second outside the loop; nothing here is needed to make a pose.
#pragma once

#include <array>
#include <cstdint>
#include <string>
#include <vector>

#include "proto/pose.h"

namespace csipose {

/// A counter and its name, where a closed list of reasons has one counter each.
struct NamedCount {
  std::string name;
  std::uint64_t count = 0;
};

/// Durations in buckets made once: adding is two increments, so that the loop can do it.
class LatencyHistogram {
 public:
  /// Upper edges of the buckets that Prometheus gets, microseconds; one more bucket holds what is longer.
  static constexpr std::array<std::uint32_t, 14> kEdgesUs = {
      1000, 2500, 5000, 10000, 15000, 20000, 25000, 30000, 40000, 50000, 75000, 100000, 150000, 250000};

  void add(std::uint32_t us);
  std::uint64_t count() const { return count_; }
  std::uint64_t sum_us() const { return sum_us_; }
  std::uint32_t max_us() const { return max_us_; }
  /// How many were at most kEdgesUs[edge].
  std::uint64_t at_most(std::size_t edge) const;
  /// The duration that a share `q` of all stays under, 3 % exact; 0 when empty.
  double quantile_us(double q) const;

 private:
  /// Quantiles need finer buckets: 32 to an octave, up to a minute.
  static constexpr std::size_t kFineBuckets = 704;
  static constexpr std::uint32_t kFineLimitUs = (1U << 26) - 1;
  static std::size_t fine_bucket(std::uint32_t us);
  static double fine_begin_us(std::size_t bucket);

  std::array<std::uint64_t, kEdgesUs.size() + 1> buckets_{};
  std::array<std::uint32_t, kFineBuckets> fine_{};
  std::uint64_t count_ = 0, sum_us_ = 0;
  std::uint32_t max_us_ = 0;
};

struct StageStatus {
  std::string name;  ///< ingest, align, window, infer, publish, end_to_end
  LatencyHistogram histogram;
};

struct ReceiverStatus {
  std::string id;
  bool present = false;  ///< its links are in the newest window
  double rate_hz = 0;    ///< usable records a second over the last second
  std::array<float, kAntennas> rssi_dbm = {kUnknown, kUnknown, kUnknown};
  UtcTime last_packet{};  ///< epoch = none yet
  std::uint64_t packets = 0, usable = 0;
  std::uint64_t lost = 0;            ///< on the air or between driver and us
  std::uint64_t filled = 0;          ///< samples repeated from an older one
  std::vector<NamedCount> rejected;  ///< datagrams and records refused, by reason
  double offset_s = kUnknown, skew_ppm = kUnknown, residual_s = kUnknown;
  double match_ratio = 0;
  std::uint64_t clock_error_ns = 0;  ///< what the agent's host says of its UTC; 0 = unknown
  std::uint64_t clock_epochs = 0;
};

enum class Level : std::uint8_t { presence = 1, position = 2, pose = 3, raw = 4 };

/// One client of the stream. Filled by the publisher.
struct ClientStatus {
  std::string name;  ///< "client 3 (json, pid 71, uid 1000)"
  Level level = Level::presence;
  std::uint64_t sent = 0, dropped = 0;
};

struct RecordingStatus {
  bool active = false;
  std::string file;
  std::uint64_t bytes = 0, errors = 0;
};

struct Status {
  std::string name, version, commit;
  std::uint64_t session = 0;
  double uptime_s = 0;
  Source source = Source::live;
  std::string source_text;  ///< PacketSource::describe()
  State state = State::warmup;
  Reasons reasons = 0;
  std::string model, model_path, model_text;  ///< whole digest; file; "tiny, 2.2 M parameters, UNTRAINED"
  bool untrained = false;
  std::string engine;  ///< Engine::describe()
  std::string config_path;
  double budget_ms = 0;
  double transmit_hz = 0;  ///< as measured; 0 = not yet known
  std::uint32_t people = 0;
  std::uint64_t frames_published = 0, deadline_misses = 0;
  std::vector<NamedCount> windows;  ///< ok, gap, skew, nan, deadline, skipped
  std::vector<ReceiverStatus> receivers;
  std::vector<StageStatus> stages;
  std::vector<NamedCount> auth_failures;   ///< by transport
  std::vector<NamedCount> config_reloads;  ///< ok, refused
  RecordingStatus recording;
  std::uint64_t watchdog_pings = 0;

  // The publisher's own; whatever is set here is overwritten by it.
  std::vector<ClientStatus> clients;
  std::uint64_t client_dropped_frames = 0;  ///< lost in clients' rings, all clients since the start
  std::uint64_t ring_dropped_frames = 0;    ///< lost between loop and publisher
};

}  // namespace csipose
