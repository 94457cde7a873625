// csipose-soak - the live path for as long as you like: three processes on the loopback feed one daemon, and every packet is
// asked for at the end. Two csipose-agents send sealed UDP, a third process sends csitool's TCP framing. With --sim the
// simulator takes their place: an office with two people who walk, three sealed receivers, and what that costs is told.
//
// Prints, for each rate: packets sent, received and counted as lost for each receiver (their difference must be 0), deadlines
// missed one by one, the delay from a window's last sample to publication and its jitter, and resident memory over
// time. Exit status 1 when a packet is unaccounted for, or memory grows.
#include <fmt/format.h>
#include <fmt/ranges.h>

#include <CLI/CLI.hpp>
#include <algorithm>
#include <map>
#include <optional>

#include "daemon/stream_client.h"
#include "model/model.h"
#include "proto/keys.h"
#include "tests/capture/made_up_packets.h"
#include "tests/daemon/program.h"

namespace csipose {
namespace {

namespace fs = std::filesystem;
using namespace std::chrono_literals;
using testing::eventually;
using testing::Program;

constexpr double kSettleShare = 0.2;  // of the run: until then memory may still be touched for the first time
constexpr long kFlatKiB = 256;        // growth of resident memory after that which is still called flat

struct Options {
  int seconds = 600;
  bool sim = false;
  std::vector<double> rates_hz = {300, 1000};
  std::string preset = "micro", precision = "f32", dat_file;
  int threads = 1, budget_ms = 50, jitter_ms = 15;
  std::vector<std::string> sets;
};

struct Sample {
  std::int64_t delay_ns, mono_ns;
};

/// What one run has seen.
struct Run {
  std::vector<Sample> frames;
  std::map<std::string, std::uint64_t> states;
  std::uint64_t dropped_before = 0;
  std::vector<long> resident_kib;  ///< once a second
  ReceivedStatus status;
  std::vector<std::string> missed;  ///< lines of the log
  std::array<std::uint64_t, kReceivers> sent{};
  double simulator_cpu_s = 0;                    ///< user and system
  std::string simulator_said;                    ///< its last line of how it went
  std::map<std::string, std::uint64_t> sources;  ///< frames by LIVE, SIMULATED
};

class Soak {
 public:
  Soak(const Options& options, double rate_hz)
      : options_(options),
        rate_hz_(rate_hz),
        folder_(fs::temp_directory_path() / fmt::format("csipose-soak.{}.{}", getpid(), rate_hz)) {
    fs::create_directories(folder_);
  }
  ~Soak() { fs::remove_all(folder_); }

  Run run() {
    prepare();
    start_daemon();
    start_senders();
    watch();
    stop_senders();
    settle();
    daemon_->send(SIGTERM);
    if (const int status = daemon_->wait(); status != 0)
      throw SetupError(ExitStatus::runtime,
                       fmt::format("the daemon ended with {}: {}", status, daemon_->log()));
    list_misses();
    return std::move(run_);
  }

 private:
  std::string in_folder(const std::string& name) const { return (folder_ / name).string(); }

  void prepare() const {
    const std::vector<std::uint8_t> weights =
        random_weights(preset_config(options_.preset), 1, HeadInit::random);
    std::ofstream(in_folder("model"), std::ios::binary)
        .write(reinterpret_cast<const char*>(weights.data()), static_cast<std::streamsize>(weights.size()));
    std::ofstream config(in_folder("csiposed.toml"));
    config << fmt::format(
        "[daemon]\nrun_dir = \"{0}\"\nstate_dir = \"{0}\"\n[model]\npath = \"{0}/model\"\nthreads = "
        "{1}\nprecision = \"{2}\"\n"
        "[ingest]\nlisten = \"udp://127.0.0.1:0\"\n{5}"
        "[loop]\nbudget_ms = {3}\njitter_ms = {4}\n[people]\nmin_score = 0.0\n",
        folder_.string(), options_.threads, options_.precision, options_.budget_ms, options_.jitter_ms,
        options_.sim ? "" : "listen_tcp = \"tcp://127.0.0.1:0\"\n");
    for (const std::string& id : sealed_receivers()) {
      create_agent_key(in_folder(id), id, options_.sim ? KeyKind::simulated : KeyKind::live);
      config << fmt::format("[[receiver]]\nid = \"{0}\"\nkey_file = \"{1}/{0}\"\n", id, folder_.string());
    }
    if (options_.sim) return;
    config << "[[receiver]]\nid = \"rx3\"\npeer = \"127.0.0.1\"\ninsecure = true\n";
    if (options_.dat_file.empty()) make_recording();
  }

  std::vector<std::string> sealed_receivers() const {
    return options_.sim ? std::vector<std::string>{"rx1", "rx2", "rx3"}
                        : std::vector<std::string>{"rx1", "rx2"};
  }

  void make_recording() const {
    testing::MadeUpTransmitter transmitter;
    transmitter.frames = 3000;
    transmitter.frame_record = [](std::int64_t frame) {
      return testing::csip_frame(static_cast<std::uint64_t>(frame) + 1);
    };
    std::ofstream file(in_folder("made_up.dat"), std::ios::binary);
    for (const testing::StoredPacket& packet :
         testing::make_packets(transmitter, {testing::MadeUpReceiver{}}))
      file.write(reinterpret_cast<const char*>(packet.bytes.data()),
                 static_cast<std::streamsize>(packet.bytes.size()));
  }
  std::string recording() const {
    return options_.dat_file.empty() ? in_folder("made_up.dat") : options_.dat_file;
  }

  void start_daemon() {
    std::vector<std::string> arguments = {"--config", in_folder("csiposed.toml")};
    for (const std::string& set : options_.sets) arguments.insert(arguments.end(), {"--set", set});
    daemon_ = std::make_unique<Program>("csiposed", arguments, folder_ / "log");
    const bool ready = eventually([&] { return daemon_->has_said("ready") || !daemon_->running(); }, 120s);
    if (!ready || !daemon_->running())
      throw SetupError(ExitStatus::runtime, "the daemon did not start: " + daemon_->log());
  }

  /// "127.0.0.1:PORT" after "udp " or "tcp " in the daemon's line "ready".
  std::string address_of(const std::string& carrier) const {
    const std::string log = daemon_->log();
    const auto at = log.find("127.0.0.1:", log.find(carrier + " ", log.find("source=")));
    return log.substr(at, log.find_first_not_of("0123456789.:", at) - at);
  }

  void start_simulator() {
    senders_.push_back(std::make_unique<Program>(
        "csipose-sim",
        std::vector<std::string>{
            "live", "--to", address_of("udp"), "--keys",
            fmt::format("{},{},{}", in_folder("rx1"), in_folder("rx2"), in_folder("rx3")), "--scene",
            "office", "--people", "2", "--rate", fmt::format("{}", rate_hz_), "--truth",
            in_folder("truth.sock")},
        folder_ / "sim.log"));
  }

  void start_senders() {
    if (options_.sim) return start_simulator();
    const std::string rate = fmt::format("{}", rate_hz_);
    for (const std::string id : {"rx1", "rx2", "rx3"}) {
      std::vector<std::string> arguments = {"--id",   id,   "--dat",  recording(),
                                            "--rate", rate, "--loop", "--inject-counter"};
      if (id == "rx3")
        arguments.insert(arguments.end(), {"--csitool-tcp", address_of("tcp")});
      else
        arguments.insert(arguments.end(), {"--key", in_folder(id), "--to", address_of("udp")});
      senders_.push_back(std::make_unique<Program>("csipose-agent", arguments, folder_ / (id + ".log")));
    }
  }

  void subscribe() {
    client_ = std::make_unique<StreamClient>(in_folder("pose.sock"), Format::protobuf);
    Subscription asked;
    asked.pose = asked.status = true;
    asked.queue = 64;
    client_->subscribe(asked);
  }

  void watch() {
    subscribe();
    const auto begin = std::chrono::steady_clock::now();
    auto measured = begin;
    while (std::chrono::steady_clock::now() - begin < std::chrono::seconds(options_.seconds)) {
      read_message(500ms);
      if (std::chrono::steady_clock::now() - measured < 1s) continue;
      measured += 1s;
      run_.resident_kib.push_back(resident_kib());
    }
  }

  void read_message(Nanoseconds timeout) {
    ServerMessage message;
    const StreamEvent event = client_->next(timeout, message);
    if (event == StreamEvent::closed)
      throw SetupError(ExitStatus::runtime, "the daemon has closed the stream: " + daemon_->log());
    if (event == StreamEvent::nothing) return;
    if (const auto* status = std::get_if<ReceivedStatus>(&message)) run_.status = *status;
    if (const auto* pose = std::get_if<ReceivedPose>(&message)) note(*pose);
  }

  void note(const ReceivedPose& pose) {
    const PoseFrame& frame = pose.frame;
    ++run_.states[std::string(name_of(frame.state))];
    ++run_.sources[std::string(name_of(frame.source))];
    run_.dropped_before += pose.dropped_before;
    const bool has_window =
        frame.state == State::tracking || frame.state == State::empty || frame.state == State::degraded;
    if (has_window && ns(frame.window_end) != 0)
      run_.frames.push_back({ns(frame.published - frame.window_end), frame.mono_ns});
  }

  long resident_kib() const {
    std::ifstream file(fmt::format("/proc/{}/status", daemon_->pid()));
    for (std::string line; std::getline(file, line);)
      if (line.starts_with("VmRSS:")) return std::stol(line.substr(6));
    return 0;
  }

  /// The simulator says at its end how much each of its receivers has sent.
  void stop_simulator() {
    run_.simulator_cpu_s = cpu_s(senders_[0]->pid());
    senders_[0]->send(SIGTERM);
    if (senders_[0]->wait() != 0)
      throw SetupError(ExitStatus::runtime, "the simulator broke: " + senders_[0]->log());
    const std::string log = senders_[0]->log();
    for (std::size_t r = 0; r < kReceivers; ++r) {
      const auto line = log.rfind(fmt::format("rx{}: ", r + 1));
      run_.sent[r] = std::stoull(log.substr(log.find(" sent=", line) + 6));
    }
    const auto end = log.find(" s put off"), begin = log.rfind("live: ", log.rfind(" s put off"));
    if (end != std::string::npos)
      run_.simulator_said = log.substr(begin + 6, log.find('\n', begin) - begin - 6);
  }

  /// User and system time of a process.
  static double cpu_s(int pid) {
    std::ifstream file(fmt::format("/proc/{}/stat", pid));
    std::string text((std::istreambuf_iterator<char>(file)), {});
    std::istringstream fields(text.substr(text.rfind(')') + 1));
    std::string word;
    for (int i = 0; i < 11; ++i) fields >> word;
    double user = 0, system = 0;
    fields >> user >> system;
    return (user + system) / static_cast<double>(sysconf(_SC_CLK_TCK));
  }

  /// The senders say at their end how much they have sent.
  void stop_senders() {
    if (options_.sim) return stop_simulator();
    for (std::size_t r = 0; r < senders_.size(); ++r) {
      senders_[r]->send(SIGTERM);
      if (senders_[r]->wait() != 0)
        throw SetupError(ExitStatus::runtime, "a sender broke: " + senders_[r]->log());
      const std::string log = senders_[r]->log();
      run_.sent[r] = std::stoull(log.substr(log.rfind(" sent=") + 6));
    }
  }

  /// Until the status speaks of a time when everything had come.
  void settle() {
    const double stopped_at = run_.status.status.uptime_s;
    while (run_.status.status.uptime_s < stopped_at + 2.5) read_message(500ms);
  }

  void list_misses() {
    std::istringstream log(daemon_->log());
    for (std::string line; std::getline(log, line);)
      if (line.find("result dropped") != std::string::npos ||
          line.find("results dropped") != std::string::npos)
        run_.missed.push_back(line);
  }

  const Options& options_;
  const double rate_hz_;
  const fs::path folder_;
  std::unique_ptr<Program> daemon_;
  std::vector<std::unique_ptr<Program>> senders_;
  std::unique_ptr<StreamClient> client_;
  Run run_;
};

// ---- the report ----

double quantile(std::vector<std::int64_t> values, double q) {
  if (values.empty()) return 0;
  std::ranges::sort(values);
  return static_cast<double>(values[static_cast<std::size_t>(q * static_cast<double>(values.size() - 1))]) *
         1e-6;
}

void report_delay(const Run& run) {
  std::vector<std::int64_t> delays, intervals;
  for (std::size_t i = 0; i < run.frames.size(); ++i) {
    delays.push_back(run.frames[i].delay_ns);
    if (i > 0) intervals.push_back(run.frames[i].mono_ns - run.frames[i - 1].mono_ns);
  }
  fmt::print(
      "  delay, last sample to publication, ms: median {:.3f}, p99 {:.3f}, p99.9 {:.3f}, largest {:.3f}\n",
      quantile(delays, 0.5), quantile(delays, 0.99), quantile(delays, 0.999), quantile(delays, 1));
  fmt::print("  jitter of the delay, ms: p99.9 - p0.1 = {:.3f}\n",
             quantile(delays, 0.999) - quantile(delays, 0.001));
  fmt::print("  time between frames, ms: median {:.3f}, p0.1 {:.3f}, p99.9 {:.3f}, largest {:.3f}\n",
             quantile(intervals, 0.5), quantile(intervals, 0.001), quantile(intervals, 0.999),
             quantile(intervals, 1));
  for (const ReceivedStatus::Latency& stage : run.status.latency)
    fmt::print("  stage {:<10} ms: median {:.3f}, p99 {:.3f}, p99.9 {:.3f}, largest {:.3f}\n", stage.stage,
               stage.p50_ms, stage.p99_ms, stage.p999_ms, stage.max_ms);
}

std::uint64_t count_of(const std::vector<NamedCount>& counts, std::string_view name) {
  for (const NamedCount& count : counts)
    if (count.name == name) return count.count;
  return 0;
}

bool report_packets(const Run& run) {
  bool all = true;
  for (std::size_t r = 0; r < kReceivers; ++r) {
    const ReceiverStatus& receiver = run.status.status.receivers.at(r);
    const std::uint64_t lost = count_of(receiver.rejected, "lost_on_the_way"),
                        full = count_of(receiver.rejected, "ring_full");
    const auto missing = static_cast<std::int64_t>(run.sent[r] - receiver.packets - lost);
    all = all && missing == 0;
    fmt::print(
        "  {}: sent {}, received {}, lost and counted {}, unaccounted {}; ring full {}, late {}, samples "
        "filled {}\n",
        receiver.id, run.sent[r], receiver.packets, lost, missing, full, count_of(receiver.rejected, "late"),
        receiver.filled);
  }
  return all;
}

bool report_memory(const Run& run) {
  const auto settled = static_cast<std::size_t>(kSettleShare * static_cast<double>(run.resident_kib.size()));
  if (settled >= run.resident_kib.size()) return true;
  const long before = run.resident_kib[settled], after = run.resident_kib.back();
  fmt::print("  resident memory, KiB: {} after {} s, {} at the end: {}\n", before, settled + 1, after,
             after - before <= kFlatKiB ? "flat" : "GROWS");
  return after - before <= kFlatKiB;
}

void report_simulator(const Run& run, int seconds) {
  fmt::print("  simulator: {}\n", run.simulator_said);
  fmt::print("  simulator: {:.1f} s of one core in {} s, {:.1f} %\n", run.simulator_cpu_s, seconds,
             100 * run.simulator_cpu_s / seconds);
  for (const auto& [source, count] : run.sources) fmt::print("  frames that say {}: {}\n", source, count);
}

bool report(const Run& run, double rate_hz, int seconds) {
  const Status& status = run.status.status;
  fmt::print("== {} packets a second, {} s, {}\n", rate_hz, seconds, status.engine);
  const bool all_packets = report_packets(run);
  if (!run.simulator_said.empty()) report_simulator(run, seconds);
  std::vector<std::string> states;
  for (const auto& [state, count] : run.states) states.push_back(fmt::format("{} {}", state, count));
  fmt::print("  frames by state: {}; lost before this subscriber {}\n", fmt::join(states, ", "),
             run.dropped_before);
  std::vector<std::string> windows;
  for (const NamedCount& count : status.windows)
    windows.push_back(fmt::format("{} {}", count.name, count.count));
  fmt::print("  windows: {}\n", fmt::join(windows, ", "));
  fmt::print("  deadlines missed: {}\n", status.deadline_misses);
  for (const std::string& line : run.missed) fmt::print("    {}\n", line);
  report_delay(run);
  return report_memory(run) && all_packets;
}

Options parse(CLI::App& app, int argc, char** argv) {
  Options options;
  app.add_option("--seconds", options.seconds, "for each rate")
      ->check(CLI::Range(5, 86400))
      ->capture_default_str();
  app.add_flag("--sim", options.sim, "the simulator in place of three senders: office, two people who walk");
  app.add_option("--rates", options.rates_hz, "packets a second of each sender")
      ->delimiter(',')
      ->capture_default_str();
  app.add_option("--preset", options.preset, "size of the network")->capture_default_str();
  app.add_option("--precision", options.precision, "auto, f32, bf16 or int8")->capture_default_str();
  app.add_option("--threads", options.threads, "of the network")->capture_default_str();
  app.add_option("--budget-ms", options.budget_ms, "delay from last sample to publication")
      ->capture_default_str();
  app.add_option("--jitter-ms", options.jitter_ms, "how long a window waits for stragglers")
      ->capture_default_str();
  app.add_option("--dat", options.dat_file, "csitool log that is sent; without it one is made up");
  app.add_option("--set", options.sets, "further settings of the daemon, section.key=value")
      ->allow_extra_args(false);
  app.parse(argc, argv);
  return options;
}

}  // namespace
}  // namespace csipose

int main(int argc, char** argv) {
  using namespace csipose;
  CLI::App app("csipose-soak: three senders on the loopback feed one daemon; every packet is accounted for");
  try {
    const Options options = parse(app, argc, argv);
    bool good = true;
    for (const double rate_hz : options.rates_hz)
      good = report(Soak(options, rate_hz).run(), rate_hz, options.seconds) && good;
    fmt::print("{}\n", good ? "soak: every packet accounted for, memory flat" : "soak: FAILED, see above");
    return good ? 0 : 1;
  } catch (const CLI::ParseError& error) {
    return app.exit(error) == 0 ? 0 : static_cast<int>(ExitStatus::usage);
  } catch (const SetupError& error) {
    fmt::print(stderr, "csipose-soak: {}\n", error.what());
    return static_cast<int>(error.status);
  }
}
