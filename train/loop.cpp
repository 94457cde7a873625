#include "train/loop.h"

#include <fmt/chrono.h>
#include <fmt/format.h>
#include <malloc.h>
#include <unistd.h>

#include <chrono>
#include <climits>
#include <cmath>
#include <csignal>
#include <cstdio>
#include <fstream>
#include <sstream>
#include <thread>

#include "proto/result.h"

namespace csipose::train {
namespace {

using Clock = std::chrono::steady_clock;
double seconds_since(Clock::time_point begin) {
  return std::chrono::duration<double>(Clock::now() - begin).count();
}

// ---- signals ----

volatile std::sig_atomic_t stop_signal = 0;
void note_signal(int number) { stop_signal = number; }

/// While it lives, SIGINT and SIGTERM ask the loop to stop after the step; the second one kills as usual.
class StopSignals {
 public:
  StopSignals() {
    stop_signal = 0;
    struct sigaction action {};
    action.sa_handler = note_signal;
    action.sa_flags = static_cast<int>(SA_RESETHAND);
    sigaction(SIGINT, &action, &old_int_);
    sigaction(SIGTERM, &action, &old_term_);
  }
  ~StopSignals() {
    sigaction(SIGINT, &old_int_, nullptr);
    sigaction(SIGTERM, &old_term_, nullptr);
  }
  StopSignals(const StopSignals&) = delete;
  StopSignals& operator=(const StopSignals&) = delete;
  static bool stopped() { return stop_signal != 0; }

 private:
  struct sigaction old_int_ {
  }, old_term_{};
};

// ---- log ----

/// log.csv: step, epoch, lr, then the figures; a header line wherever the figures change, as at the end of an epoch.
class RunLog {
 public:
  RunLog(const std::filesystem::path& file, std::uint64_t first_step) {
    const std::string kept = rows_up_to(file, first_step);
    out_.open(file, std::ios::trunc);
    out_ << kept << std::flush;
    if (!out_)
      throw SetupError(ExitStatus::cannot_create, fmt::format("{} cannot be written", file.string()));
  }

  void row(const char* kind, const Moment& now, double rate, const Figures& figures) {
    std::string line = fmt::format("{},{},{},{:.1f}", kind, now.step, now.epoch + 1, rate);
    for (const auto& [name, value] : figures) line += fmt::format(",{},{:.6g}", name, value);
    out_ << line << '\n' << std::flush;
  }

 private:
  /// The rows of an earlier part of this run, without what it did after its last checkpoint.
  static std::string rows_up_to(const std::filesystem::path& file, std::uint64_t step) {
    std::ifstream old(file);
    std::string kept = "kind,step,epoch,windows_per_s,figures\n", line;
    std::getline(old, line);
    while (step > 0 && std::getline(old, line)) {
      std::istringstream cells(line);
      std::string kind, at;
      std::getline(cells, kind, ',');
      std::getline(cells, at, ',');
      if (std::strtoull(at.c_str(), nullptr, 10) <= step) kept += line + '\n';
    }
    return kept;
  }

  std::ofstream out_;
};

/// Means of figures between two lines.
class Means {
 public:
  void add(const Figures& figures) {
    if (sums_.empty())
      for (const auto& [name, value] : figures) sums_.emplace_back(name, 0);
    for (std::size_t i = 0; i < figures.size(); ++i) sums_[i].second += figures[i].second;
    ++count_;
  }
  Figures take() {
    for (auto& [name, sum] : sums_) sum /= static_cast<double>(count_);
    count_ = 0;
    return std::exchange(sums_, {});
  }
  std::uint64_t count() const { return count_; }

 private:
  Figures sums_;
  std::uint64_t count_ = 0;
};

std::string words_of(const Figures& figures) {
  std::string words;
  for (const auto& [name, value] : figures) words += fmt::format("  {} {:.4g}", name, value);
  return words;
}

/// What a person sees: one line, rewritten in a terminal.
class Progress {
 public:
  explicit Progress(bool shown) : shown_(shown), terminal_(::isatty(STDERR_FILENO) != 0) {}
  void step(const Moment& now, double rate, double seconds_per_step, const Figures& figures) const {
    if (!shown_) return;
    const std::chrono::seconds left(
        static_cast<std::int64_t>(seconds_per_step * static_cast<double>(now.total - now.step)));
    fmt::print(stderr, "{}step {} of {}  epoch {}  {:.0f} windows/s{}  {:%H:%M:%S} left{}",
               terminal_ ? "\r\x1b[K" : "", now.step, now.total, now.epoch + 1, rate, words_of(figures), left,
               terminal_ ? "" : "\n");
    std::fflush(stderr);
  }
  void line(const std::string& words) const {
    if (shown_) fmt::print(stderr, "{}{}\n", terminal_ ? "\r\x1b[K" : "", words);
  }

 private:
  bool shown_, terminal_;
};

// ---- steps ----

std::vector<at::Tensor> gradients(const AdamW& optimiser) {
  std::vector<at::Tensor> all;
  for (const ParameterGroup& group : optimiser.groups())
    for (const auto& [name, parameter] : group.parameters)
      if (parameter.grad().defined()) all.push_back(parameter.grad());
  return all;
}

class Loop {
 public:
  Loop(Objective& objective, const LoopPlan& plan, const RunSettings& settings, const Workers& workers,
       const CheckpointFolder& folder, std::uint64_t first_step)
      : objective_(objective),
        plan_(plan),
        settings_(settings),
        workers_(workers),
        folder_(folder),
        progress_(workers.first()),
        first_step_(first_step) {
    if (workers.first()) log_.emplace(folder.path() / "log.csv", first_step);
  }

  Outcome run() {
    const StopSignals signals;
    const std::uint64_t per_epoch = plan_.steps_per_epoch(workers_), total = plan_.total(workers_);
    for (std::uint64_t made = first_step_; made < total; ++made) {
      const Moment now{made + 1, total, made / per_epoch};
      make_step(now, made % per_epoch);
      if ((made + 1) % per_epoch == 0) end_epoch(now);
      if (must_stop(now)) {
        checkpoint(now.step);
        progress_.line(
            fmt::format("stopped after step {} of {}; the same command goes on from here", now.step, total));
        return {now.step, false};
      }
      if (seconds_since(last_checkpoint_) > 60 * settings_.run.checkpoint_minutes) checkpoint(now.step);
    }
    if (workers_.first()) objective_.finish({total, total, plan_.epochs - 1});
    checkpoint(total);
    return {total, true};
  }

 private:
  /// The windows that this process has of step `i` of an epoch.
  std::span<const std::uint64_t> windows_of(std::uint64_t epoch, std::uint64_t i) {
    if (epoch != ordered_epoch_) {
      order_ = shuffled(plan_.windows, static_cast<std::uint64_t>(settings_.run.seed), epoch);
      ordered_epoch_ = epoch;
    }
    const std::uint64_t part =
        i * static_cast<std::uint64_t>(workers_.size()) + static_cast<std::uint64_t>(workers_.rank());
    return std::span(order_).subspan(part * plan_.batch, plan_.batch);
  }

  void make_step(const Moment& now, std::uint64_t i) {
    Figures figures;
    objective_.optimiser().clear_gradients();
    const at::Tensor loss = objective_.loss(windows_of(now.epoch, i), now, figures);
    loss.backward();
    workers_.average(gradients(objective_.optimiser()));
    const double value = workers_.average(loss.item<double>());
    if (!std::isfinite(value))
      throw std::runtime_error(
          fmt::format("the loss of step {} is not finite; the last checkpoint in {} is from before. "
                      "A smaller learning rate may help, or run.precision = f32",
                      now.step, folder_.path().string()));
    const double rate = objective_.make_step(now, figures);
    figures.insert(figures.begin(), {{"loss", value}, {"lr", rate}});
    means_.add(figures);
    if (seconds_since(last_line_) >= settings_.run.log_s) write_line(now);
  }

  void write_line(const Moment& now) {
    const double elapsed_s = seconds_since(last_line_);
    const auto steps = static_cast<double>(means_.count());
    const double rate = steps * static_cast<double>(plan_.batch) * workers_.size() / elapsed_s;
    const Figures figures = means_.take();
    progress_.step(now, rate, elapsed_s / steps, figures);
    if (log_) log_->row("step", now, rate, figures);
    last_line_ = Clock::now();
  }

  void end_epoch(const Moment& now) {
    if (means_.count() > 0) write_line(now);
    Figures figures;
    objective_.end_epoch(now, figures);
    progress_.line(fmt::format("epoch {} of {}{}", now.epoch + 1, plan_.epochs, words_of(figures)));
    if (log_) log_->row("epoch", now, 0, figures);
    last_line_ = Clock::now();
  }

  bool must_stop(const Moment& now) const {
    const bool asked =
        StopSignals::stopped() || now.step == static_cast<std::uint64_t>(settings_.run.stop_after_steps);
    return workers_.any(asked) && now.step < now.total;
  }

  void checkpoint(std::uint64_t step) {
    if (workers_.first()) folder_.write(step, objective_.weights(), objective_.optimiser().state());
    last_checkpoint_ = Clock::now();
  }

  Objective& objective_;
  const LoopPlan& plan_;
  const RunSettings& settings_;
  const Workers& workers_;
  const CheckpointFolder& folder_;
  Progress progress_;
  std::uint64_t first_step_;
  std::optional<RunLog> log_;
  Means means_;
  Clock::time_point last_line_ = Clock::now(), last_checkpoint_ = Clock::now();
  std::vector<std::uint64_t> order_;
  std::uint64_t ordered_epoch_ = UINT64_MAX;
};

/// What must be the same for a run to go on to the same bits.
std::string identity(RunSettings settings) {
  const RunSettings defaults;
  settings.run.threads = defaults.run.threads;
  settings.run.log_s = defaults.run.log_s;
  settings.run.checkpoint_minutes = defaults.run.checkpoint_minutes;
  settings.run.stop_after_steps = defaults.run.stop_after_steps;
  settings.run.out = defaults.run.out;
  return to_toml(settings, false);
}

/// The first line that two texts do not share.
std::string first_difference(const std::string& then, const std::string& now) {
  std::istringstream a(then), b(now);
  std::string line_a, line_b;
  while (std::getline(a, line_a) && std::getline(b, line_b))
    if (line_a != line_b) return fmt::format("then '{}', now '{}'", line_a, line_b);
  return "its length";
}

double matmul_s(const at::TensorOptions& options) {
  const at::NoGradGuard no_gradients;
  const at::Tensor x = at::ones({2048, 256}, options), w = at::ones({1024, 256}, options);
  const auto once = [&] { at::linear(x, w)[0][0].item(); };  // a device is waited for
  once();
  double best = HUGE_VAL;
  for (int round = 0; round < 5; ++round) {
    const Clock::time_point begin = Clock::now();
    once();
    best = std::min(best, seconds_since(begin));
  }
  return best;
}

}  // namespace

void prepare_machine(const RunSettings& settings) {
  // Tensors of some megabytes come and go each step; without this glibc gives each back to the kernel, page by page.
  ::mallopt(M_MMAP_THRESHOLD, INT_MAX);
  ::mallopt(M_TRIM_THRESHOLD, INT_MAX);
  const unsigned threads = settings.run.threads > 0 ? static_cast<unsigned>(settings.run.threads)
                                                    : std::thread::hardware_concurrency();
  at::set_num_threads(static_cast<int>(std::max(1u, threads)));
  at::globalContext().setFlushDenormal(true);
}

std::uint64_t LoopPlan::steps_per_epoch(const Workers& workers) const {
  const std::uint64_t together = batch * static_cast<std::uint64_t>(workers.size());
  const std::uint64_t steps = windows.size() / together;
  if (steps == 0)
    throw SetupError(
        ExitStatus::bad_config,
        fmt::format("{} windows to learn from are fewer than a batch of {}; take a smaller batch or more "
                    "data",
                    windows.size(), together));
  return steps;
}

Outcome run_loop(Objective& objective, const LoopPlan& plan, const RunSettings& settings,
                 const Workers& workers, const CheckpointFolder& folder, std::uint64_t first_step) {
  return Loop(objective, plan, settings, workers, folder, first_step).run();
}

std::optional<Checkpoint> checkpoint_to_resume(const CheckpointFolder& folder, const RunSettings& settings) {
  std::optional<Checkpoint> found = folder.newest();
  if (!found) return found;
  const std::string then = identity(parse_run_text(found->weights.metadata["run"], folder.path().string()));
  const std::string now = identity(settings);
  if (then != now)
    throw SetupError(
        ExitStatus::bad_config,
        fmt::format("{} holds a run that was begun with other settings ({}); take another run.out, or "
                    "remove it",
                    folder.path().string(), first_difference(then, now)));
  return found;
}

at::Device device_of(const RunSettings& settings, const Workers& workers) {
  const auto devices = static_cast<int>(torch::cuda::device_count());
  if (settings.run.device == "cuda" && devices == 0)
    throw SetupError(
        ExitStatus::unavailable,
        "run.device is cuda, but this libtorch sees no such device; take cpu or auto, or build with a "
        "libtorch that has CUDA (-DTORCH_ROOT=DIR)");
  if (settings.run.device == "cpu" || devices == 0) return at::kCPU;
  return {at::kCUDA, static_cast<at::DeviceIndex>(workers.rank() % devices)};
}

Numerics choose_numerics(const RunSettings& settings, const std::optional<Checkpoint>& resumed,
                         const at::Device& device) {
  std::string precision = settings.run.precision;
  if (precision == "auto" && resumed) precision = resumed->weights.metadata.at("numerics");
  const auto of = [&](at::ScalarType type) { return matmul_s(at::TensorOptions(device).dtype(type)); };
  if (precision == "auto") precision = of(at::kBFloat16) < 0.9 * of(at::kFloat) ? "bf16" : "f32";
  return {precision == "bf16" ? at::kBFloat16 : at::kFloat, 0};
}

}  // namespace csipose::train
