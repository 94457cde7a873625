// daemon/loop_thread.h - the thread of the loop: real-time requests, engine and warm-up, then live or replay.
//
// The engine is made on this thread because OpenMP keeps a team of workers per calling thread: made
// elsewhere, the warm workers would not be the ones that the loop uses.
#pragma once

#include <exception>
#include <functional>
#include <future>
#include <memory>
#include <optional>
#include <string>
#include <thread>

#include "daemon/config.h"
#include "daemon/loop.h"
#include "model/model.h"

namespace csipose {

/// What the loop's thread has to tell before it begins.
struct LoopReady {
  std::string engine;                             ///< Engine::describe()
  std::vector<std::string> refusals;              ///< what the kernel did not grant, in words
  std::array<double, kReceivers + 1> infer_ms{};  ///< [n] = median of the network with n receivers present
};

class LoopThread {
 public:
  struct Parts {
    std::shared_ptr<const Model> model;
    PacketInput& input;
    FrameSink& sink;
    FrameFacts facts;
    /// A replay begins when this says so; asked every few milliseconds.
    std::function<bool()> may_begin;
  };
  LoopThread(const Config& config, const Parts& parts, LoopLink& link);
  ~LoopThread() { stop(); }

  /// Starts the thread and waits until the engine is warm, asking `give_up` meanwhile. nullopt: it said so, and the
  /// thread is still loading, which cannot be broken off. Throws what went wrong there.
  std::optional<LoopReady> start(const std::function<bool()>& give_up);
  void stop();
  bool ended() const { return ended_.load(std::memory_order_acquire); }
  /// What ended the loop before its time. After ended().
  std::exception_ptr failure() const { return failure_; }

 private:
  void run();
  LoopReady prepare();
  void serve();

  const Config config_;
  const Parts parts_;
  LoopLink& link_;
  std::unique_ptr<PoseEstimator> estimator_;
  std::promise<LoopReady> ready_;
  std::atomic<bool> ended_{false};
  std::exception_ptr failure_;
  std::thread thread_;
};

/// Runs the network often enough that caches, code and workers are warm, with each number of receivers that
/// the model allows. Returns the medians.
std::array<double, kReceivers + 1> warm_up(Engine& engine, std::size_t min_links);

}  // namespace csipose
