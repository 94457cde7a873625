// `csipose demo`: a receiver's bytes to poses on a socket, whole, on this computer alone: three agents send a recording
// through the sealed UDP door of a daemon, and a live view shows what it streams. Everything lives in a private folder
// that is gone afterwards; nothing listens beyond loopback.
#include <arpa/inet.h>
#include <fmt/format.h>
#include <sys/socket.h>
#include <unistd.h>

#include <CLI/CLI.hpp>
#include <csignal>
#include <cstring>
#include <filesystem>
#include <fstream>
#include <memory>
#include <thread>

#include "daemon/child_process.h"
#include "daemon/tool.h"
#include "proto/keys.h"

namespace csipose {
namespace {

namespace fs = std::filesystem;
using std::chrono::steady_clock;

/// Set by SIGINT, SIGTERM and SIGHUP: the view ends, and with it everything, in order.
volatile std::sig_atomic_t asked_to_stop = 0;

struct DemoOptions {
  std::vector<std::string> files;
  std::string preset = "tiny", model;
  double for_seconds = 0, rate_hz = 300;
};

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
    make_recording();
    make_model();
    make_keys();
    write_config();
    start_daemon();
    start_agents();
    return watch();
  }

 private:
  /// One file for each receiver: three that were named, one for all, or the closed-form scene.
  void make_recording() {
    recordings_ = options_.files;
    if (recordings_.empty()) {
      run("csipose-sim",
          {"record", "--scene", "reflector", "--out", (folder_ / "recording").string(), "--rate",
           fmt::format("{}", options_.rate_hz)},
          folder_ / "sim.log");
      for (const char* name : {"rx1.dat", "rx2.dat", "rx3.dat"})
        recordings_.push_back(folder_ / "recording" / name);
    }
    if (recordings_.size() == 1) recordings_.resize(3, recordings_[0]);
    if (recordings_.size() != 3)
      throw SetupError(ExitStatus::usage,
                       fmt::format("{} recordings were named: give one for all three receivers, or "
                                   "three",
                                   recordings_.size()));
  }

  void make_model() {
    model_ = options_.model;
    if (!model_.empty()) return;
    model_ = folder_ / "untrained.safetensors";
    run("csipose", {"model", "init", "--preset", options_.preset, "--seed", "1", "--out", model_},
        folder_ / "model.log");
  }

  void make_keys() const {
    const KeyKind kind = options_.files.empty() ? KeyKind::simulated : KeyKind::replay;
    for (int r = 1; r <= 3; ++r) create_agent_key(key(r), fmt::format("rx{}", r), kind);
  }

  void write_config() const {
    std::ofstream out(config());
    out << fmt::format("[daemon]\nname = \"demo\"\nrun_dir = \"{0}\"\nstate_dir = \"{0}\"\n",
                       (folder_ / "").string())
        << fmt::format("[ingest]\nlisten = \"udp://127.0.0.1:{}\"\n", port_)
        << fmt::format("[window]\nsample_rate_hz = {:.1f}\n", options_.rate_hz)
        << fmt::format("[model]\npath = \"{}\"\n", model_);
    constexpr double kAcross_m[] = {0.5, 1.75, 3.0};  // where csipose-sim puts them
    for (int r = 1; r <= 3; ++r)
      out << fmt::format("[[receiver]]\nid = \"rx{}\"\nposition_m = [4.0, {}, 1.0]\nkey_file = \"{}\"\n", r,
                         kAcross_m[r - 1], key(r));
    if (!out.flush()) throw SetupError(ExitStatus::io, fmt::format("cannot write {}", config()));
  }

  void start_daemon() {
    daemon_ = std::make_unique<ChildProcess>(sibling_program("csiposed"),
                                             std::vector<std::string>{"--config", config()},
                                             folder_ / "csiposed.log");
    const auto deadline = steady_clock::now() + std::chrono::seconds(60);
    while (!fs::exists(folder_ / "pose.sock")) {
      if (daemon_->ended() || steady_clock::now() > deadline) complain(*daemon_);
      std::this_thread::sleep_for(std::chrono::milliseconds(20));
    }
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
      agents_.push_back(std::make_unique<ChildProcess>(sibling_program("csipose-agent"), arguments,
                                                       folder_ / fmt::format("agent{}.log", r)));
    }
  }

  /// The live view, in the foreground; a part that ends before it is told with its last words.
  int watch() {
    std::vector<std::string> arguments = {"watch", "--config", config()};
    if (options_.for_seconds > 0)
      arguments.insert(arguments.end(), {"--for", fmt::format("{}", options_.for_seconds)});
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

  ChildProcess* first_ended() {
    if (daemon_->ended()) return daemon_.get();
    for (const auto& agent : agents_)
      if (agent->ended()) return agent.get();
    return nullptr;
  }

  std::string key(int receiver) const { return folder_ / fmt::format("rx{}.key", receiver); }
  std::string config() const { return folder_ / "csiposed.toml"; }

  DemoOptions options_;
  PrivateFolder folder_;
  int port_;
  std::vector<std::string> recordings_;
  std::string model_;
  std::unique_ptr<ChildProcess> daemon_;
  std::vector<std::unique_ptr<ChildProcess>> agents_;  // stopped before the daemon
};

}  // namespace

void add_demo(CLI::App& app) {
  auto options = std::make_shared<DemoOptions>();
  CLI::App* demo =
      app.add_subcommand("demo", "three agents, a daemon and a live view on this computer, in one go");
  demo->add_option(
          "recording", options->files,
          "csitool .dat log: one for all receivers, or three; without it a closed-form moving reflector")
      ->check(CLI::ExistingFile);
  demo->add_option("--model", options->model, "weights; without it random ones, and the view says UNTRAINED")
      ->check(CLI::ExistingFile);
  demo->add_option("--preset", options->preset,
                   "size of the random weights: paper, base, small, tiny, micro");
  demo->add_option("--rate", options->rate_hz, "packets a second of each agent")
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
