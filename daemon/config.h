// daemon/config.h - every setting of csiposed: where it comes from, what it may be, what a reload may change.
//
// Order, later wins: built-in defaults, the main file, conf.d/*.toml beside it in name order, environment
// variables CSIPOSED_SECTION__KEY, --set section.key=value. One table (config_keys()) names each key once,
// with its range, its help and whether a running daemon takes it; reading, checking, showing and reloading
// all walk that table.
#pragma once

#include <array>
#include <filesystem>
#include <map>
#include <span>
#include <string>
#include <string_view>
#include <variant>
#include <vector>

namespace csipose {

/// One of the three receivers. For live sources exactly one door: key_file, peer or local.
struct ReceiverConfig {
  std::string id;
  std::array<double, 3> position_m{};
  std::string key_file;
  std::string peer;
  bool insecure = false;
  bool local = false;
  bool operator==(const ReceiverConfig&) const = default;
};

struct Config {
  struct {
    std::string name = "csipose", log_level = "info";
    std::string state_dir = "/var/lib/csiposed", run_dir = "/run/csiposed";
  } daemon;
  struct {
    std::array<double, 3> size_m{4.0, 3.5, 2.6}, transmitter_m{0.0, 1.75, 1.0};
  } room;
  std::vector<ReceiverConfig> receivers;
  struct {
    std::string kind = "agents";
    std::vector<std::string> files;
    double speed = 1.0;
    bool loop = false;
    double rate_hz = 0;
    int wait_clients = 0;
  } source;
  struct {
    std::string listen = "udp://127.0.0.1:8481", listen_tcp;
    std::string counter = "automatic", align = "tx_counter";
    double tx_rate_hz = 0;
    int max_skew_ms = 20, stale_after_ms = 500;
    int session_ttl_s = 3600, max_pps_per_receiver = 3000;
  } ingest;
  struct {
    int hop = 10;
    double sample_rate_hz = 300;
    int max_gap = 2, stream = 0;
  } window;
  struct {
    std::string phase = "joint", amplitude = "raw", antenna_permutation = "undo", rotation_40mhz = "undo";
  } sanitise;
  struct {
    std::string path = "/usr/share/csiposed/models/default.safetensors", sha256;
    std::string engine = "onednn", precision = "auto";
    int threads = 2;
  } model;
  struct {
    int jitter_ms = 15, budget_ms = 50;
    std::vector<int> cpu_affinity;
    int realtime_priority = 0;
    bool lock_memory = false;
  } loop;
  struct {
    int max = 5;
    double min_score = 0.4, nms_distance_m = 0.25;
    bool track = true;
    int track_timeout_ms = 1000, score_memory_ms = 300;
    std::string smoothing = "none";
  } people;
  struct {
    std::string socket = "pose.sock", control_socket = "control.sock";
    int max_clients = 64, queue_frames = 8, idle_close_s = 10;
  } stream;
  struct {
    std::string textfile;
  } metrics;
  struct {
    bool enabled = false;
    std::string dir = "recordings";
    std::vector<std::string> content{"csi", "pose"};
    int rotate_mb = 256, rotate_min = 60;
    int keep_days = 7, keep_total_mb = 4096;
  } record;
  struct {
    std::string max_level = "pose";
  } privacy;

  /// Where a key that is not at its default got its value: "csiposed.toml:12:7", "--set", "environment
  /// variable ...".
  std::map<std::string, std::string> origins;

  /// `run_dir` or `state_dir` put before a relative path.
  std::filesystem::path in_run_dir(const std::string& path) const;
  std::filesystem::path in_state_dir(const std::string& path) const;
};

// ---- the table ----

using Field = std::variant<bool*, int*, double*, std::string*, std::vector<int>*, std::vector<std::string>*,
                           std::array<double, 3>*>;

/// What a value may be: numbers within [min, max] (each one of a list), words among `words` (empty = any
/// text).
struct Allowed {
  double min = 0, max = 0;
  std::vector<std::string_view> words{};
};

enum class Change : std::uint8_t { restart, reload };

template <class Owner>
struct Key {
  std::string_view name;  ///< "window.hop"; of a receiver: "id"
  Field (*field)(Owner&);
  Allowed allowed;
  Change change;
  std::string_view help;
};
std::span<const Key<Config>> config_keys();
std::span<const Key<ReceiverConfig>> receiver_keys();

// ---- reading ----

inline constexpr const char* kDefaultConfigFile = "/etc/csiposed/csiposed.toml";

struct ConfigSources {
  std::string file;              ///< empty = kDefaultConfigFile, which may be absent
  std::vector<std::string> set;  ///< "section.key=value"
  std::vector<std::pair<std::string, std::string>>
      environment;  ///< name, value; others than CSIPOSED_* are ignored
};
/// The process's environment in the form that ConfigSources wants.
std::vector<std::pair<std::string, std::string>> process_environment();

/// Reads and checks everything. Throws SetupError (bad_config; no_input when a named file is not there) whose
/// words name, one line each, every mistake: file, line, column, key, why, and what is allowed.
Config load_config(const ConfigSources& sources);

/// The configuration as TOML. `with_help` adds what each key means and may be; otherwise each value that is
/// not the default says where it came from.
std::string to_toml(const Config& config, bool with_help);

/// "key = value" lines of the keys that `wanted` chooses.
std::string values_as_text(const Config& config, bool (*wanted)(std::string_view key));

// ---- reload ----

struct ReloadOutcome {
  std::vector<std::string> applied;        ///< "people.min_score = 0.7"
  std::vector<std::string> needs_restart;  ///< "window.hop = 5: needs restart, 10 stays"
};
/// Takes over into `running` what a running daemon can take; everything else stays as it is.
ReloadOutcome apply_reload(Config& running, Config fresh);

}  // namespace csipose
