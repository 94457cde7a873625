#include "daemon/settings.h"

#include <fmt/format.h>
#include <sodium.h>

#include <algorithm>
#include <fstream>

#include "capture/live_source.h"
#include "capture/netlink_source.h"
#include "capture/replay.h"
#include "capture/tcp_source.h"
#include "capture/udp_source.h"
#include "proto/keys.h"
#include "proto/result.h"
#include "version.h"

namespace csipose {
namespace {

/// The value that goes with a word; the configuration has let no other word pass.
template <class Value>
Value meaning(const std::string& word, std::initializer_list<std::pair<std::string_view, Value>> meanings) {
  for (const auto& [name, value] : meanings)
    if (name == word) return value;
  throw SetupError(ExitStatus::bug, fmt::format("no meaning is known for the word {}", word));
}

std::array<float, 3> as_floats(const std::array<double, 3>& values) {
  return {static_cast<float>(values[0]), static_cast<float>(values[1]), static_cast<float>(values[2])};
}

Nanoseconds milliseconds(int count) { return std::chrono::milliseconds(count); }

void demand_equal(const Model& model, std::string_view key, const std::string& configured,
                  const std::string& demanded) {
  if (configured == demanded) return;
  throw SetupError(
      ExitStatus::bad_config,
      fmt::format(
          "the model {} was made for {} = {}, the configuration says {}; they must agree, so set it to {} or "
          "choose another model",
          model.file_name(), key, demanded, configured, demanded));
}

void check_demand(const Config& config, const Model& model) {
  const WindowDemand& demand = model.demand();
  demand_equal(model, "window.sample_rate_hz", fmt::format("{}", config.window.sample_rate_hz),
               fmt::format("{}", demand.rate_hz));
  demand_equal(model, "sanitise.phase", config.sanitise.phase, demand.phase);
  demand_equal(model, "sanitise.amplitude", config.sanitise.amplitude, demand.amplitude);
}

int inherited(const std::map<std::string, int>& sockets, const std::string& name) {
  const auto found = sockets.find(name);
  return found == sockets.end() ? -1 : found->second;
}

// ---- live doors ----

std::unique_ptr<LiveSource> udp_of(const Config& config, const std::map<std::string, int>& sockets) {
  UdpSourceConfig udp;
  udp.listen = config.ingest.listen;
  udp.inherited_socket = inherited(sockets, "udp");
  udp.limits.lifetime = std::chrono::seconds(config.ingest.session_ttl_s);
  udp.limits.max_per_second = static_cast<std::uint32_t>(config.ingest.max_pps_per_receiver);
  for (std::size_t i = 0; i < config.receivers.size(); ++i) {
    const ReceiverConfig& receiver = config.receivers[i];
    if (receiver.key_file.empty()) continue;
    AgentKey key = load_agent_key(receiver.key_file);
    if (key.name != receiver.id)
      throw SetupError(ExitStatus::bad_config,
                       fmt::format("the key file {} belongs to {}, but receiver {} names it",
                                   receiver.key_file, key.name, receiver.id));
    udp.agents.push_back({static_cast<std::uint8_t>(i), key});
  }
  return udp.agents.empty() ? nullptr : std::make_unique<UdpSource>(udp);
}

std::unique_ptr<LiveSource> tcp_of(const Config& config) {
  std::vector<TcpPeer> peers;
  for (std::size_t i = 0; i < config.receivers.size(); ++i) {
    const ReceiverConfig& receiver = config.receivers[i];
    if (!receiver.peer.empty())
      peers.push_back(
          {static_cast<std::uint8_t>(i), config.ingest.listen_tcp, receiver.peer, receiver.insecure});
  }
  return peers.empty() ? nullptr : std::make_unique<TcpSource>(peers);
}

std::unique_ptr<LiveSource> netlink_of(const Config& config) {
  const auto local = std::ranges::find_if(config.receivers, &ReceiverConfig::local);
  if (local == config.receivers.end()) return nullptr;
  return std::make_unique<NetlinkSource>(static_cast<std::uint8_t>(local - config.receivers.begin()));
}

// ---- digest of a replay ----

class Digest {
 public:
  Digest() { crypto_hash_sha256_init(&state_); }
  void add(std::string_view bytes) {
    crypto_hash_sha256_update(&state_, reinterpret_cast<const unsigned char*>(bytes.data()), bytes.size());
  }
  void add_file(const std::string& path) {
    std::ifstream file(path, std::ios::binary);
    std::vector<char> block(1 << 20);
    while (file.read(block.data(), static_cast<std::streamsize>(block.size())) || file.gcount() > 0)
      add({block.data(), static_cast<std::size_t>(file.gcount())});
  }
  std::uint64_t first_64_bits() {
    std::array<unsigned char, crypto_hash_sha256_BYTES> hash;
    crypto_hash_sha256_final(&state_, hash.data());
    return load_le<std::uint64_t>(hash.data());
  }

 private:
  crypto_hash_sha256_state state_;
};

/// Sections whose values change what frames say; where files lie or how clients are served does not.
bool shapes_frames(std::string_view key) {
  for (const char* section :
       {"ingest.counter", "ingest.align", "ingest.tx_rate_hz", "ingest.max_skew_ms", "ingest.stale_after_ms",
        "source.rate_hz", "source.loop", "window.", "sanitise.", "model.engine", "model.precision",
        "model.threads", "loop.jitter_ms", "loop.budget_ms", "people."})
    if (key.starts_with(section)) return true;
  return false;
}

}  // namespace

FrontEndConfig front_end_config(const Config& config) {
  FrontEndConfig front;
  front.grid_hz = config.window.sample_rate_hz;
  front.tx_hz = config.ingest.tx_rate_hz;
  front.hop = config.window.hop;
  front.max_gap = config.window.max_gap;
  front.stream = config.window.stream;
  front.phase = meaning<PhaseMethod>(config.sanitise.phase,
                                     {{"joint", PhaseMethod::joint}, {"phasefi", PhaseMethod::phasefi}});
  front.amplitude = meaning<AmplitudeMethod>(
      config.sanitise.amplitude, {{"raw", AmplitudeMethod::raw}, {"scaled", AmplitudeMethod::scaled}});
  front.counter = meaning<CounterMethod>(config.ingest.counter, {{"automatic", CounterMethod::automatic},
                                                                 {"csip", CounterMethod::csip},
                                                                 {"sequence16", CounterMethod::sequence16},
                                                                 {"lfsr", CounterMethod::lfsr},
                                                                 {"sequence12", CounterMethod::sequence12},
                                                                 {"none", CounterMethod::none}});
  front.align = meaning<AlignMethod>(config.ingest.align,
                                     {{"tx_counter", AlignMethod::tx_counter}, {"time", AlignMethod::time}});
  front.undo_permutation = config.sanitise.antenna_permutation == "undo";
  front.undo_40mhz_rotation = config.sanitise.rotation_40mhz == "undo";
  front.max_skew = milliseconds(config.ingest.max_skew_ms);
  return front;
}

EstimatorConfig estimator_config(const Config& config) {
  EstimatorConfig people;
  people.max_people = config.people.max;
  people.min_score = static_cast<float>(config.people.min_score);
  people.nms_distance_m = static_cast<float>(config.people.nms_distance_m);
  people.track = config.people.track;
  people.track_timeout = milliseconds(config.people.track_timeout_ms);
  people.score_memory = milliseconds(config.people.score_memory_ms);
  people.smoothing = meaning<Smoothing>(config.people.smoothing,
                                        {{"none", Smoothing::none}, {"one_euro", Smoothing::one_euro}});
  return people;
}

LoopTiming loop_timing(const Config& config) {
  return {milliseconds(config.loop.jitter_ms), milliseconds(config.loop.budget_ms), config.source.speed};
}

StreamLimits stream_limits(const Config& config) {
  StreamLimits limits;
  limits.max_level =
      meaning<Level>(config.privacy.max_level,
                     {{"presence", Level::presence}, {"position", Level::position}, {"pose", Level::pose}});
  limits.queue_frames = static_cast<std::uint32_t>(config.stream.queue_frames);
  limits.pose_hz = static_cast<float>(config.window.sample_rate_hz / config.window.hop);
  limits.idle_close = std::chrono::seconds(config.stream.idle_close_s);
  return limits;
}

std::vector<std::string> receiver_ids(const Config& config) {
  if (config.receivers.empty()) return {"rx1", "rx2", "rx3"};
  std::vector<std::string> ids;
  for (const ReceiverConfig& receiver : config.receivers) ids.push_back(receiver.id);
  return ids;
}

Hello hello_of(const Config& config, const Model& model, Source source, std::uint64_t session) {
  Hello hello;
  hello.name = config.daemon.name;
  hello.session = session;
  hello.source = source;
  hello.model = model.digest().substr(0, 12);
  hello.untrained = model.untrained();
  hello.room.size_m = as_floats(config.room.size_m);
  hello.room.transmitter_m = as_floats(config.room.transmitter_m);
  for (const ReceiverConfig& receiver : config.receivers)
    hello.room.receivers.push_back({receiver.id, as_floats(receiver.position_m)});
  hello.level = stream_limits(config).max_level;
  hello.sample_hz = static_cast<float>(config.window.sample_rate_hz);
  hello.pose_hz = stream_limits(config).pose_hz;
  hello.budget_ms = static_cast<float>(config.loop.budget_ms);
  hello.clock = source == Source::replay ? "recording" : "utc";
  return hello;
}

std::shared_ptr<const Model> load_model(const Config& config) {
  std::shared_ptr<const Model> model = Model::load(config.model.path);
  if (!config.model.sha256.empty() && model->digest() != config.model.sha256)
    throw SetupError(
        ExitStatus::bad_data,
        fmt::format(
            "the model {} has the digest {}, model.sha256 demands {}; it is another file than was meant",
            config.model.path, model->digest(), config.model.sha256));
  check_demand(config, *model);
  return model;
}

std::unique_ptr<Engine> make_engine(const Config& config, std::shared_ptr<const Model> model) {
  if (config.model.engine == "reference") return make_reference_engine(std::move(model));
  OneDnnOptions options;
  options.threads = config.model.threads;
  options.cpus = config.loop.cpu_affinity;
  if (config.model.precision != "auto")
    options.precision =
        meaning<Precision>(config.model.precision,
                           {{"f32", Precision::f32}, {"bf16", Precision::bf16}, {"int8", Precision::int8}});
  try {
    return make_onednn_engine(std::move(model), options);
  } catch (const SetupError&) {
    throw;
  } catch (const std::exception& error) {
    throw SetupError(
        ExitStatus::os_refusal,
        fmt::format(
            "the engine could not be made: {}; oneDNN compiles its kernels at start, so the system must "
            "allow executable memory (MemoryDenyWriteExecute=no in the unit)",
            error.what()));
  }
}

std::unique_ptr<PacketSource> make_source(const Config& config, const std::map<std::string, int>& sockets) {
  if (config.source.kind == "file")
    return open_replay({config.source.files, config.source.rate_hz, config.source.loop});
  std::vector<std::unique_ptr<LiveSource>> doors;
  if (auto udp = udp_of(config, sockets)) doors.push_back(std::move(udp));
  if (auto tcp = tcp_of(config)) doors.push_back(std::move(tcp));
  if (auto netlink = netlink_of(config)) doors.push_back(std::move(netlink));
  return std::make_unique<LiveSources>(std::move(doors));
}

std::unique_ptr<RecorderThread> make_recorder(const Config& config, Source source) {
  const auto holds = [&](const char* what) { return std::ranges::count(config.record.content, what) > 0; };
  RecorderConfig recorder;
  recorder.folder = config.in_state_dir(config.record.dir);
  recorder.info.source = source;
  const std::vector<std::string> ids = receiver_ids(config);
  std::ranges::copy(ids, recorder.info.receivers.begin());
  recorder.info.software = "csiposed " CSIPOSE_VERSION " (commit " CSIPOSE_COMMIT ")";
  if (holds("pose")) recorder.pose_schema = pose_schema();
  recorder.rotate_bytes = static_cast<std::uint64_t>(config.record.rotate_mb) << 20;
  recorder.rotate_age = std::chrono::minutes(config.record.rotate_min);
  recorder.keep_age = std::chrono::hours(24 * config.record.keep_days);
  recorder.keep_bytes = static_cast<std::uint64_t>(config.record.keep_total_mb) << 20;
  const bool lossless = source == Source::replay && config.source.speed == 0;
  return std::make_unique<RecorderThread>(recorder, RecorderThread::Content{holds("csi"), holds("pose")},
                                          lossless);
}

std::uint64_t session_number(const Config& config, const Model& model) {
  if (config.source.kind != "file") {
    std::uint64_t number = 0;
    randombytes_buf(&number, sizeof number);
    return number;
  }
  Digest digest;
  for (const std::string& file : config.source.files) digest.add_file(file);
  digest.add(model.digest());
  digest.add(values_as_text(config, shapes_frames));
  return digest.first_64_bits();
}

}  // namespace csipose
