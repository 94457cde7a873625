// bench/train - windows a second of a training step, beside the bare matmuls of the same shapes.
//
//     build/release/bin/train_bench [PRESET...] [--threads N] [--steps N]
//
// For each preset, for pre-training (batch 64, link masking) and fine-tuning (batch 32, one to three people), in float32 and
// with bfloat16 operands: windows a second of whole steps (data, forward, backward, optimiser), windows a second if only the
// step's matmuls were done, forward and backward, one after the other on operands that are there; and their ratio.
#include <fmt/core.h>
#include <unistd.h>

#include <CLI/CLI.hpp>
#include <chrono>
#include <filesystem>
#include <fstream>
#include <sstream>
#include <vector>

#include "tests/train/made_up_set.h"
#include "train/finetune.h"
#include "train/losses.h"
#include "train/masks.h"
#include "train/pretrain.h"

namespace csipose::train {
namespace {

using Clock = std::chrono::steady_clock;
double seconds_since(Clock::time_point begin) {
  return std::chrono::duration<double>(Clock::now() - begin).count();
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
    const Clock::time_point begin = Clock::now();
    once();
    best = std::min(best, seconds_since(begin));
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

/// Seconds of one whole step, the least of some.
double step_s(bool pre, const std::string& preset, const char* precision, int steps) {
  RunSettings settings;
  settings.network.preset = preset;
  settings.run.precision = precision;
  settings.run.checkpoint_minutes = 1e6;
  settings.run.log_s = 0;
  settings.data.hold_out = 0;
  settings.run.stop_after_steps = steps;
  const auto folder =
      std::filesystem::temp_directory_path() / fmt::format("csipose_train_bench_{}", ::getpid());
  settings.run.out = folder.string();
  const int batch = pre ? settings.pretrain.batch : settings.finetune.batch;
  settings.finetune.lose_receiver = settings.finetune.lose_two_receivers = settings.finetune.lose_links = 0;
  Pool pool({std::make_shared<testing::MadeUpSet>(static_cast<std::size_t>(batch) * (steps + 1), 3, 1)});
  (pre ? pretrain : finetune)(settings, pool, Workers());
  double fastest = 0;
  std::ifstream log(folder / "log.csv");
  for (std::string line; std::getline(log, line);)
    if (line.rfind("step,", 0) == 0) {
      std::istringstream cells(line);
      std::string cell;
      for (int i = 0; i < 4; ++i) std::getline(cells, cell, ',');
      fastest = std::max(fastest, std::stod(cell));
    }
  std::filesystem::remove_all(folder);
  return batch / fastest;
}

void measure(const std::string& preset, int steps) {
  const NetworkConfig config = preset_config(preset);
  for (const bool pre : {true, false})
    for (const char* precision : {"f32", "bf16"}) {
      const std::size_t batch = pre ? RunSettings().pretrain.batch : RunSettings().finetune.batch;
      const at::ScalarType type = precision == std::string_view("bf16") ? at::kBFloat16 : at::kFloat;
      const double whole = step_s(pre, preset, precision, steps);
      const double bound = bound_s(pre ? pretraining(config, batch) : finetuning(config, batch), type);
      const auto windows = static_cast<double>(batch);
      fmt::print("{:6} {:8} {:4}  {:7.1f} windows/s  bound {:7.1f}  {:4.2f}\n", preset,
                 pre ? "pretrain" : "finetune", precision, windows / whole, windows / bound, bound / whole);
      std::fflush(stdout);
    }
}

}  // namespace
}  // namespace csipose::train

int main(int argc, char** argv) {
  CLI::App app("train_bench: windows a second of training steps beside their matmuls");
  std::vector<std::string> presets{"micro", "tiny", "small"};
  csipose::train::RunSettings machine;
  int steps = 4;
  app.add_option("presets", presets, "paper, base, small, tiny, micro");
  app.add_option("--threads", machine.run.threads, "0: as many as the machine has");
  app.add_option("--steps", steps, "of which the fastest counts");
  CLI11_PARSE(app, argc, argv);
  csipose::train::prepare_machine(machine);
  for (const std::string& preset : presets) csipose::train::measure(preset, steps);
}
