// `csipose demo`: receivers' bytes to poses on a socket, whole, on this computer alone: the simulator, or three agents that
// send a recording, through the sealed UDP door of a daemon, and a live view that shows what it streams, beside the
// simulator's truth. Everything lives in a private folder that is gone afterwards; nothing listens beyond loopback.
#include <arpa/inet.h>
#include <fmt/format.h>
#include <fmt/ranges.h>
#include <sys/socket.h>
#include <unistd.h>

#include <CLI/CLI.hpp>
#include <array>
#include <csignal>
#include <cstring>
#include <filesystem>
#include <fstream>
#include <memory>
#include <thread>

#include "daemon/child_process.h"
#include "daemon/tool.h"
#include "daemon/truth_client.h"
#include "proto/keys.h"
#include "proto/wire.h"

namespace csipose {
namespace {

namespace fs = std::filesystem;
using std::chrono::steady_clock;

/// Set by SIGINT, SIGTERM and SIGHUP: the view ends, and with it everything, in order.
volatile std::sig_atomic_t asked_to_stop = 0;

struct DemoOptions {
  std::vector<std::string> files;
  std::string preset, model, scene = "office";
  int people = 2;
  std::vector<int> silent;
  double for_seconds = 0, rate_hz = 300;
};

/// What the cards in a built-in room are like: as in the data set that the shipped weights learnt from
/// (docs/simulator-dataset.md, simpiw). Elsewhere they are powered up for the occasion.
int installation_in(const std::string& scene) {
  const std::array<const char*, 3> rooms = {"office", "classroom", "corridor"};
  const auto found = std::find(rooms.begin(), rooms.end(), scene);
  return found == rooms.end() ? 0 : 1 + static_cast<int>(found - rooms.begin());
}

/// A UDP port of the loopback that is free now.
int free_port() {
  const int fd = socket(AF_INET, SOCK_DGRAM, 0);
  sockaddr_in address{};
  address.sin_family = AF_INET;
  address.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
  socklen_t size = sizeof address;
  const bool known = fd >= 0 && bind(fd, reinterpret_cast<sockaddr*>(&address), size) == 0 &&
                     getsockname(fd, reinterpret_cast<sockaddr*>(&address), &size) == 0;
  const int error = errno;
  if (fd >= 0) close(fd);
  if (!known)
    throw SetupError(ExitStatus::os_refusal,
                     fmt::format("no free UDP port on 127.0.0.1: {}", std::strerror(error)));
  return ntohs(address.sin_port);
}

[[noreturn]] void complain(ChildProcess& child) {
  throw SetupError(ExitStatus::runtime, fmt::format("{} ended with status {}; its last words:\n{}",
                                                    child.name(), child.wait(), child.last_words()));
}

/// Runs a program of ours to its end.
void run(const std::string& program, const std::vector<std::string>& arguments, const fs::path& log) {
  ChildProcess child(sibling_program(program), arguments, log);
  if (child.wait() != 0) complain(child);
}

class Demo {
 public:
  explicit Demo(const DemoOptions& options) : options_(options), port_(free_port()) {}

  int operator()() {
    make_model();
    make_keys();
    const RoomDescription room = is_simulated() ? start_simulator() : choose_recordings();
    write_config(room);
    start_daemon();
    if (!is_simulated()) start_agents();
    const int status = watch();
    if (is_simulated()) tell_if_late();
    return status;
  }

 private:
  bool is_simulated() const { return options_.files.empty(); }

  /// Three virtual receivers that wait for the daemon; the room that they stand in.
  RoomDescription start_simulator() {
    std::vector<std::string> arguments{"live",
                                       "--to",
                                       fmt::format("127.0.0.1:{}", port_),
                                       "--keys",
                                       fmt::format("{},{},{}", key(1), key(2), key(3)),
                                       "--scene",
                                       options_.scene,
                                       "--people",
                                       fmt::format("{}", options_.people),
                                       "--rate",
                                       fmt::format("{}", options_.rate_hz),
                                       "--truth",
                                       truth_socket(),
                                       "--power-up",
                                       fmt::format("{}", installation_in(options_.scene))};
    if (!options_.silent.empty())
      arguments.insert(arguments.end(), {"--silent", fmt::format("{}", fmt::join(options_.silent, ","))});
    senders_.push_back(std::make_unique<ChildProcess>(sibling_program("csipose-sim"), arguments, sim_log()));
    wait_for(truth_socket(), *senders_.back());
    const TruthClient truth(truth_socket());
    const auto place = [](const Point3& p) { return std::array{p.x, p.y, p.z}; };
    RoomDescription room{place(truth.hello()->size_m), place(truth.hello()->transmitter_m), {}};
    for (const Point3& receiver : truth.hello()->receivers_m)
      room.receivers.push_back({fmt::format("rx{}", room.receivers.size() + 1), place(receiver)});
    return room;
  }

  /// One file for each receiver: three that were named, or one for all. Nothing is known of the room: it is drawn as if
  /// the receivers stood along one wall.
  RoomDescription choose_recordings() {
    recordings_ = options_.files;
    if (recordings_.size() == 1) recordings_.resize(3, recordings_[0]);
    if (recordings_.size() != 3)
      throw SetupError(ExitStatus::usage,
                       fmt::format("{} recordings were named: give one for all three receivers, or "
                                   "three",
                                   recordings_.size()));
    return {
        {4, 3.5F, 2.6F}, {0, 1.75F, 1}, {{"rx1", {4, 0.5F, 1}}, {"rx2", {4, 1.75F, 1}}, {"rx3", {4, 3, 1}}}};
  }

  /// The shipped weights know simulated people; of a recording from elsewhere they would tell tales.
  void make_model() {
    model_ = options_.model;
    if (model_.empty() && is_simulated() && options_.preset.empty()) model_ = shipped_weights();
    if (!model_.empty()) return;
    const std::string preset = options_.preset.empty() ? "tiny" : options_.preset;
    model_ = folder_ / "untrained.safetensors";
    run("csipose", {"model", "init", "--preset", preset, "--seed", "1", "--out", model_},
        folder_ / "model.log");
  }

  void make_keys() const {
    const KeyKind kind = is_simulated() ? KeyKind::simulated : KeyKind::replay;
    for (int r = 1; r <= 3; ++r) create_agent_key(key(r), fmt::format("rx{}", r), kind);
  }

  void write_config(const RoomDescription& room) const {
    std::ofstream out(config());
    out << fmt::format("[daemon]\nname = \"demo\"\nrun_dir = \"{0}\"\nstate_dir = \"{0}\"\n",
                       (folder_ / "").string())
        << fmt::format("[ingest]\nlisten = \"udp://127.0.0.1:{}\"\n", port_)
        << fmt::format("[model]\npath = \"{}\"\n", model_)
        << fmt::format("[room]\nsize_m = [{:.2f}]\ntransmitter_m = [{:.2f}]\n", fmt::join(room.size_m, ", "),
                       fmt::join(room.transmitter_m, ", "));
    for (std::size_t r = 0; r < room.receivers.size(); ++r)
      out << fmt::format("[[receiver]]\nid = \"{}\"\nposition_m = [{:.2f}]\nkey_file = \"{}\"\n",
                         room.receivers[r].id, fmt::join(room.receivers[r].position_m, ", "),
                         key(static_cast<int>(r) + 1));
    if (!out.flush()) throw SetupError(ExitStatus::io, fmt::format("cannot write {}", config()));
  }

  /// Until a program of ours has made its socket.
  static void wait_for(const std::string& socket, ChildProcess& program) {
    const auto deadline = steady_clock::now() + std::chrono::seconds(60);
    while (!fs::exists(socket)) {
      if (program.ended() || asked_to_stop || steady_clock::now() > deadline) complain(program);
      std::this_thread::sleep_for(std::chrono::milliseconds(20));
    }
  }

  void start_daemon() {
    daemon_ = std::make_unique<ChildProcess>(sibling_program("csiposed"),
                                             std::vector<std::string>{"--config", config()},
                                             folder_ / "csiposed.log");
    wait_for(folder_ / "pose.sock", *daemon_);
  }

  /// A loop plays on the host's clock, so the three are in step as receivers of one transmitter are.
  void start_agents() {
    for (int r = 1; r <= 3; ++r) {
      const std::vector<std::string> arguments = {"--id",   fmt::format("rx{}", r),
                                                  "--key",  key(r),
                                                  "--to",   fmt::format("127.0.0.1:{}", port_),
                                                  "--dat",  recordings_[static_cast<std::size_t>(r - 1)],
                                                  "--rate", fmt::format("{}", options_.rate_hz),
                                                  "--loop", "--inject-counter"};
      senders_.push_back(std::make_unique<ChildProcess>(sibling_program("csipose-agent"), arguments,
                                                        folder_ / fmt::format("agent{}.log", r)));
    }
  }

  /// The live view, in the foreground; a part that ends before it is told with its last words.
  int watch() {
    std::vector<std::string> arguments = {"watch", "--config", config()};
    if (options_.for_seconds > 0)
      arguments.insert(arguments.end(), {"--for", fmt::format("{}", options_.for_seconds)});
    if (is_simulated()) arguments.insert(arguments.end(), {"--truth", truth_socket()});
    if (tool_options().no_color) arguments.push_back("--no-color");
    ChildProcess view(sibling_program("csipose"), arguments, {});
    ChildProcess* failed = nullptr;
    while (!asked_to_stop && !view.ended() && !(failed = first_ended()))
      std::this_thread::sleep_for(std::chrono::milliseconds(50));
    view.ask_to_stop();
    const int status = view.wait();
    if (failed) complain(*failed);
    return status;
  }

  /// The simulator's complaint, if it had one: its log goes with the folder.
  void tell_if_late() const {
    std::ifstream log(sim_log());
    for (std::string line; std::getline(log, line);)
      if (line.find("cannot keep up") != std::string::npos) {
        fmt::print(stderr, "{}\n", line);
        return;
      }
  }

  ChildProcess* first_ended() {
    if (daemon_->ended()) return daemon_.get();
    for (const auto& sender : senders_)
      if (sender->ended()) return sender.get();
    return nullptr;
  }

  std::string key(int receiver) const { return folder_ / fmt::format("rx{}.key", receiver); }
  std::string truth_socket() const { return folder_ / "truth.sock"; }
  fs::path sim_log() const { return folder_ / "sim.log"; }
  std::string config() const { return folder_ / "csiposed.toml"; }

  DemoOptions options_;
  PrivateFolder folder_;
  int port_;
  std::vector<std::string> recordings_;
  std::string model_;
  std::unique_ptr<ChildProcess> daemon_;
  std::vector<std::unique_ptr<ChildProcess>> senders_;  // simulator or agents; stopped before the daemon
};

}  // namespace

void add_demo(CLI::App& app) {
  auto options = std::make_shared<DemoOptions>();
  CLI::App* demo = app.add_subcommand(
      "demo",
      "simulator, daemon and live view on this computer, in one go; or three agents that send your logs");
  demo->add_option("recording", options->files,
                   "csitool .dat log: one for all receivers, or three; without it people are simulated")
      ->check(CLI::ExistingFile);
  demo->add_option(
          "--model", options->model,
          "weights; without it those that came with the program for simulated people, random ones for "
          "recordings")
      ->check(CLI::ExistingFile);
  demo->add_option(
      "--preset", options->preset,
      "random weights of this size, and the view says UNTRAINED: paper, base, small, tiny, micro");
  demo->add_option("--scene", options->scene,
                   "where people are simulated: office, classroom, corridor, empty or a room's file")
      ->capture_default_str();
  demo->add_option("--people", options->people, "how many are simulated")
      ->check(CLI::Range(0, 3))
      ->capture_default_str();
  demo->add_option("--silent", options->silent, "simulated receivers that are switched off, by number")
      ->type_name("N,N")
      ->delimiter(',')
      ->check(CLI::Range(1, 3));
  demo->add_option("--rate", options->rate_hz, "packets a second of each receiver")
      ->check(CLI::Range(10.0, 3000.0));
  demo->add_option("--for", options->for_seconds, "end after so many seconds; without it Ctrl-C ends it");
  demo->callback([options] {
    for (const int number : {SIGINT, SIGTERM, SIGHUP}) std::signal(number, [](int) { asked_to_stop = 1; });
    const int status = Demo(*options)();
    if (status != 0)
      throw SetupError(static_cast<ExitStatus>(status), "the live view ended with an error, see above");
  });
}

}  // namespace csipose
