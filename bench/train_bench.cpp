// train_bench - windows a second of a training step, beside the bare matmuls of the same shapes; bench/train runs it beside
// PyTorch.
//
//     build/release/bin/train_bench [PRESET...] [--threads N] [--steps N] [--json] [--parts]
//
// For each preset, for pre-training (batch 64, link masking) and fine-tuning (batch 32, one to three people), in float32 and
// with bfloat16 operands: windows a second of whole steps (data, forward, backward, optimiser), windows a second if only the
// step's matmuls were done, forward and backward, one after the other on operands that are there; and their ratio.
//
// With one thread, times are processor time, which others' work disturbs less than the clock on the wall.
// --parts: where a step's time goes, by libtorch's operators without what they call.
#include <ATen/record_function.h>
#include <fmt/core.h>
#include <unistd.h>

#include <CLI/CLI.hpp>
#include <algorithm>
#include <atomic>
#include <ctime>
#include <filesystem>
#include <map>
#include <numeric>
#include <vector>

#include "model/cpu.h"
#include "proto/result.h"
#include "tests/train/made_up_set.h"
#include "train/finetune.h"
#include "train/losses.h"
#include "train/masks.h"
#include "train/pretrain.h"

namespace csipose::train {
namespace {

struct Options {
  std::vector<std::string> presets{"micro", "tiny", "small"};
  std::vector<std::string> objectives{"pretrain", "finetune"}, precisions{"f32", "bf16"};
  RunSettings machine;
  int steps = 4;
  bool json = false, parts = false;
};

double now_s() {
  timespec time{};
  ::clock_gettime(at::get_num_threads() == 1 ? CLOCK_PROCESS_CPUTIME_ID : CLOCK_MONOTONIC, &time);
  return static_cast<double>(time.tv_sec) + 1e-9 * static_cast<double>(time.tv_nsec);
}

/// `batch` products of (m, k) and (k, n), `count` times a step.
struct Product {
  std::int64_t batch, m, k, n;
  double count;
};

void add_linear(std::vector<Product>& list, std::size_t rows, std::size_t in, std::size_t out, double count) {
  list.push_back({1, static_cast<std::int64_t>(rows), static_cast<std::int64_t>(in),
                  static_cast<std::int64_t>(out), count});
}
void add_attention(std::vector<Product>& list, std::size_t windows, std::size_t heads, std::size_t queries,
                   std::size_t keys, std::size_t width, double count) {
  const auto each = static_cast<std::int64_t>(windows * heads);
  const auto q = static_cast<std::int64_t>(queries), k = static_cast<std::int64_t>(keys),
             d = static_cast<std::int64_t>(width);
  list.push_back({each, q, d, k, count});
  list.push_back({each, q, k, d, count});
}
void add_blocks(std::vector<Product>& list, std::size_t windows, std::size_t tokens, std::size_t dim,
                std::size_t heads, double count) {
  const std::size_t rows = windows * tokens;
  add_linear(list, rows, dim, 3 * dim, count);
  add_attention(list, windows, heads, tokens, tokens, dim / heads, count);
  add_linear(list, rows, dim, dim, count);
  add_linear(list, rows, dim, 4 * dim, count);
  add_linear(list, rows, 4 * dim, dim, count);
}
void add_decoder_layers(std::vector<Product>& list, const NetworkConfig& c, std::size_t windows,
                        std::size_t groups, std::size_t queries, double count) {
  const std::size_t rows = windows * groups * queries, e = c.decoder_dim, head = e / c.decoder_heads;
  add_linear(list, rows, e, 3 * e, count);
  add_attention(list, windows * groups, c.decoder_heads, queries, queries, head, count);
  add_linear(list, rows, e, e, 3 * count);
  add_linear(list, windows * kTokens, e, 2 * e, count);
  add_attention(list, windows, c.decoder_heads, groups * queries, kTokens, head, count);
  add_linear(list, rows, e, c.ffn, count);
  add_linear(list, rows, c.ffn, e, count);
}
void add_keypoint_head(std::vector<Product>& list, const NetworkConfig& c, std::size_t rows, double count) {
  add_linear(list, rows, c.decoder_dim, c.kpt_hidden, count);
  add_linear(list, rows, c.kpt_hidden, c.kpt_hidden, 2 * count);
  add_linear(list, rows, c.kpt_hidden, 3 * kJoints, count);
}

struct Step {
  std::vector<Product> both;     ///< forward and backward
  std::vector<Product> forward;  ///< forward alone: the target of pre-training
};
Step pretraining(const NetworkConfig& c, std::size_t windows) {
  const PredictorShape p = predictor_shape(c.preset);
  Step step;
  const auto depth = static_cast<double>(c.depth);
  add_blocks(step.forward, windows, kTokens, c.dim, c.heads, depth);
  add_blocks(step.both, windows, 80, c.dim, c.heads, depth);
  add_blocks(step.both, windows, kTokens, p.dim, p.heads, static_cast<double>(p.depth));
  add_linear(step.both, windows * 80, c.dim, p.dim, 1);
  add_linear(step.both, windows * 100, p.dim, c.dim, 1);
  return step;
}
Step finetuning(const NetworkConfig& c, std::size_t windows) {
  Step step;
  add_blocks(step.both, windows, kTokens, c.dim, c.heads, static_cast<double>(c.depth));
  add_linear(step.both, windows * kTokens, c.dim, c.decoder_dim, 1);
  add_decoder_layers(step.both, c, windows, 1, c.queries, static_cast<double>(c.decoder_layers));
  add_decoder_layers(step.both, c, windows, 3, kJoints, static_cast<double>(c.refine_layers));
  add_keypoint_head(step.both, c, windows * kTokens, 1);
  add_keypoint_head(step.both, c, windows * c.queries, static_cast<double>(c.decoder_layers));
  return step;
}

double product_s(const Product& p, at::ScalarType type, bool backward) {
  const at::Tensor x = at::rand({p.batch, p.m, p.k}).to(type), w = at::rand({p.batch, p.k, p.n}).to(type),
                   g = at::rand({p.batch, p.m, p.n}).to(type);
  const auto once = [&] {
    at::bmm(x, w);
    if (backward) {
      at::bmm(g, w.transpose(1, 2));
      at::bmm(x.transpose(1, 2), g);
    }
  };
  once();
  double best = HUGE_VAL;
  for (int round = 0; round < 3; ++round) {
    const double begin = now_s();
    once();
    best = std::min(best, now_s() - begin);
  }
  return p.count * best;
}
double bound_s(const Step& step, at::ScalarType type) {
  const at::NoGradGuard no_gradients;
  double sum = 0;
  for (const Product& product : step.both) sum += product_s(product, type, true);
  for (const Product& product : step.forward) sum += product_s(product, type, false);
  return sum;
}

/// From start() to stop(), what libtorch's operators take, each without the operators that it calls.
class Parts {
 public:
  void start() {
    sums_.clear();
    handle_ =
        at::addGlobalCallback(at::RecordFunctionCallback(&begin, &end)
                                  .scopes({at::RecordScope::FUNCTION, at::RecordScope::BACKWARD_FUNCTION}));
    all_s_ = -now_s();
  }
  void stop() {
    all_s_ += now_s();
    at::removeCallback(handle_);
  }
  void print() const {
    std::vector<std::pair<double, std::string>> order;
    double sum = 0;
    for (const auto& [name, self_s] : sums_) order.emplace_back(self_s, name), sum += self_s;
    order.emplace_back(all_s_ - sum, "(no operator)");
    std::sort(order.rbegin(), order.rend());
    for (const auto& [self_s, name] : order)
      if (self_s > 0.01 * all_s_) fmt::print("    {:4.1f} %  {}\n", 100 * self_s / all_s_, name);
  }

 private:
  struct Call {
    std::string name;
    double begin_s, inner_s;
  };
  static std::unique_ptr<at::ObserverContext> begin(const at::RecordFunction& function) {
    calls_.push_back({function.name(), now_s(), 0});
    return nullptr;
  }
  static void end(const at::RecordFunction&, at::ObserverContext*) {
    const Call call = calls_.back();
    calls_.pop_back();
    const double took_s = now_s() - call.begin_s;
    sums_[call.name] += took_s - call.inner_s;
    if (!calls_.empty()) calls_.back().inner_s += took_s;
  }

  // libtorch calls functions, not objects: there is one of these at a time.
  static inline std::vector<Call> calls_;
  static inline std::map<std::string, double> sums_;
  at::CallbackHandle handle_ = 0;
  double all_s_ = 0;
};

/// Says when each batch was asked for: steps begin there. The first step warms up, the last one's end nobody sees.
class ClockedSet : public testing::MadeUpSet {
 public:
  ClockedSet(std::size_t batch, std::size_t steps, Parts* parts)
      : MadeUpSet(batch * steps, 3, 1), batch_(batch), begins_(steps), parts_(parts) {}
  void read(std::size_t i, std::span<float> x) const override {
    if (const std::size_t read = reads_++; read % batch_ == 0) begin(read / batch_);
    MadeUpSet::read(i, x);
  }
  double least_step_s() const {
    double least = HUGE_VAL;
    for (std::size_t i = 2; i < begins_.size(); ++i) least = std::min(least, begins_[i] - begins_[i - 1]);
    return least;
  }

 private:
  void begin(std::size_t step) const {
    if (parts_ != nullptr && step == 1) parts_->start();
    if (parts_ != nullptr && step + 1 == begins_.size()) parts_->stop();
    begins_[step] = now_s();
  }

  std::size_t batch_;
  mutable std::atomic<std::size_t> reads_ = 0;
  mutable std::vector<double> begins_;
  Parts* parts_;
};

std::size_t batch_of(const std::string& objective) {
  return static_cast<std::size_t>(objective == "pretrain" ? RunSettings().pretrain.batch
                                                          : RunSettings().finetune.batch);
}

/// Seconds of one whole step, the least of some.
double step_s(const std::string& objective, const std::string& preset, const std::string& precision,
              int steps, Parts* parts = nullptr) {
  RunSettings settings;
  settings.network.preset = preset;
  settings.run.precision = precision;
  settings.run.checkpoint_minutes = settings.run.log_s = 1e6;
  settings.data.hold_out = 0;
  settings.data.norm = "none";
  settings.run.stop_after_steps = steps + 2;
  const auto folder =
      std::filesystem::temp_directory_path() / fmt::format("csipose_train_bench_{}", ::getpid());
  settings.run.out = folder.string();
  settings.finetune.lose_receiver = settings.finetune.lose_two_receivers = settings.finetune.lose_links = 0;
  const auto set =
      std::make_shared<ClockedSet>(batch_of(objective), static_cast<std::size_t>(steps) + 2, parts);
  Pool pool({set});
  (objective == "pretrain" ? pretrain : finetune)(settings, pool, Workers());
  std::filesystem::remove_all(folder);
  return set->least_step_s();
}

/// Numbers that the objective learns.
std::size_t learned_numbers(const std::string& objective, const NetworkConfig& config) {
  if (objective == "finetune") return parameter_count(config);
  std::vector<TensorSpec> specs = predictor_tensors(predictor_shape(config.preset), config.dim);
  for (const TensorSpec& spec : required_tensors(config))
    if (spec.name.rfind("encoder.", 0) == 0) specs.push_back(spec);
  std::size_t numbers = 0;
  for (const TensorSpec& spec : specs)
    numbers += std::accumulate(spec.shape.begin(), spec.shape.end(), std::size_t{1}, std::multiplies<>());
  return numbers;
}

/// The configuration as JSON, and the predictor's sizes with it.
std::string sizes_of(const NetworkConfig& config) {
  const PredictorShape p = predictor_shape(config.preset);
  std::string json = to_json(config);
  json.insert(json.size() - 1, fmt::format(",\"predictor\":[{},{},{}]", p.dim, p.depth, p.heads));
  return json;
}

void measure(const Options& options, const std::string& preset, const std::string& objective,
             const std::string& precision) {
  const NetworkConfig config = preset_config(preset);
  const std::size_t batch = batch_of(objective);
  const at::ScalarType type = precision == "bf16" ? at::kBFloat16 : at::kFloat;
  const double whole = step_s(objective, preset, precision, options.steps);
  const double bound =
      bound_s(objective == "pretrain" ? pretraining(config, batch) : finetuning(config, batch), type);
  const auto windows = static_cast<double>(batch);
  if (options.json)
    fmt::print("{{\"step_s\":{:.6f},\"bound_s\":{:.6f},\"windows\":{},\"parameters\":{},\"sizes\":{}}}\n",
               whole, bound, batch, learned_numbers(objective, config), sizes_of(config));
  else
    fmt::print("{:6} {:8} {:4}  {:7.1f} windows/s  bound {:7.1f}  {:4.2f}\n", preset, objective, precision,
               windows / whole, windows / bound, bound / whole);
  std::fflush(stdout);
}

void measure_all(const Options& options) {
  prepare_machine(options.machine);
  if (options.parts && at::get_num_threads() != 1)
    throw SetupError(ExitStatus::usage, "--parts adds up one thread's calls; say --threads 1");
  for (const std::string& preset : options.presets)
    for (const std::string& objective : options.objectives)
      for (const std::string& precision : options.precisions) {
        measure(options, preset, objective, precision);
        if (!options.parts) continue;
        Parts parts;
        step_s(objective, preset, precision, options.steps, &parts);
        parts.print();
      }
}

}  // namespace
}  // namespace csipose::train

int main(int argc, char** argv) try {
  csipose::bound_spinning();
  CLI::App app("train_bench: windows a second of training steps beside their matmuls");
  csipose::train::Options options;
  app.add_option("presets", options.presets, "paper, base, small, tiny, micro");
  app.add_option("--objectives", options.objectives)
      ->delimiter(',')
      ->check(CLI::IsMember({"pretrain", "finetune"}));
  app.add_option("--precisions", options.precisions)->delimiter(',')->check(CLI::IsMember({"f32", "bf16"}));
  app.add_option("--threads", options.machine.run.threads, "0: as many as the machine has");
  app.add_option("--steps", options.steps, "of which the fastest counts")->check(CLI::PositiveNumber);
  app.add_flag("--json", options.json, "one JSON object a line");
  app.add_flag("--parts", options.parts, "where a step's time goes, by operator; one thread");
  CLI11_PARSE(app, argc, argv);
  csipose::train::measure_all(options);
} catch (const std::exception& error) {
  std::fprintf(stderr, "train_bench: %s\n", error.what());
  return 1;
}
