#include "daemon/loop_thread.h"

#include <pthread.h>

#include <algorithm>
#include <random>

#include "daemon/settings.h"

namespace csipose {
namespace {

constexpr int kWarmUpRuns = 20;  // for each number of tokens
constexpr Nanoseconds kAskAgain = std::chrono::milliseconds(5);

/// Numbers in the range of amplitudes and phases; what they are does not matter to time.
std::vector<float> any_tensor() {
  std::vector<float> x(std::tuple_size_v<decltype(Window::x)>);
  std::minstd_rand random(1);
  for (float& value : x) value = static_cast<float>(random() % 4096) / 512.f - 4.f;
  return x;
}

double median_ms(Engine& engine, const std::vector<float>& x, LinkSet links) {
  MonotonicClock clock;
  std::array<double, kWarmUpRuns> times_ms;
  for (double& time_ms : times_ms) {
    const SteadyTime start = clock.now();
    engine.run(x, links);
    time_ms = seconds(clock.now() - start) * 1e3;
  }
  std::ranges::sort(times_ms);
  return times_ms[kWarmUpRuns / 2];
}

std::vector<std::string> ask_for_real_time(const Config& config) {
  std::vector<std::string> refusals;
  const auto note = [&](const Refusal& refusal) {
    if (refusal) refusals.push_back(*refusal);
  };
  use_precise_timers();
  if (config.loop.lock_memory) note(lock_all_memory());
  if (!config.loop.cpu_affinity.empty()) note(pin_this_thread(config.loop.cpu_affinity.front()));
  if (config.loop.realtime_priority > 0) note(run_with_realtime_priority(config.loop.realtime_priority));
  return refusals;
}

}  // namespace

std::array<double, kReceivers + 1> warm_up(Engine& engine, std::size_t min_links) {
  const std::vector<float> x = any_tensor();
  std::array<double, kReceivers + 1> medians_ms{};
  for (std::size_t receivers = kReceivers; receivers * kAntennas >= std::max<std::size_t>(min_links, 1);
       --receivers)
    medians_ms[receivers] = median_ms(engine, x, LinkSet((1u << (receivers * kAntennas)) - 1));
  return medians_ms;
}

LoopThread::LoopThread(const Config& config, const Parts& parts, LoopLink& link)
    : config_(config), parts_(parts), link_(link) {}

std::optional<LoopReady> LoopThread::start(const std::function<bool()>& give_up) {
  std::future<LoopReady> ready = ready_.get_future();
  thread_ = std::thread([this] { run(); });
  while (ready.wait_for(kAskAgain) != std::future_status::ready)
    if (give_up()) return std::nullopt;
  return ready.get();
}

void LoopThread::stop() {
  link_.stop = true;
  if (thread_.joinable()) thread_.join();
}

void LoopThread::run() {
  pthread_setname_np(pthread_self(), "loop");
  try {
    ready_.set_value(prepare());
  } catch (...) {
    ended_ = true;
    return ready_.set_exception(std::current_exception());
  }
  serve();
  ended_.store(true, std::memory_order_release);
}

LoopReady LoopThread::prepare() {
  LoopReady ready;
  ready.refusals = ask_for_real_time(config_);
  std::unique_ptr<Engine> engine = make_engine(config_, parts_.model);
  ready.infer_ms = warm_up(*engine, parts_.model->demand().min_links);
  ready.engine = engine->describe();
  estimator_ = std::make_unique<PoseEstimator>(parts_.model, std::move(engine), estimator_config(config_));
  return ready;
}

void LoopThread::serve() {
  MonotonicClock clock;
  FrontEnd front_end(front_end_config(config_));
  FrameMaker frames(front_end, *estimator_, estimator_config(config_), parts_.facts);
  std::unique_ptr<Loop> loop;
  if (parts_.facts.source == Source::replay)
    loop =
        std::make_unique<ReplayLoop>(parts_.input, frames, parts_.sink, clock, link_, loop_timing(config_));
  else
    loop = std::make_unique<LiveLoop>(parts_.input, frames, parts_.sink, clock, link_, loop_timing(config_));
  for (; !parts_.may_begin() && !link_.stop; clock.sleep_until(clock.now() + kAskAgain)) ++link_.progress;
  try {
    loop->run();
  } catch (...) {
    failure_ = std::current_exception();
    loop->publish_fault();
  }
}

}  // namespace csipose
