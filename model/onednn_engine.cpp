#include "model/onednn_engine.h"

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <algorithm>
#include <array>
#include <chrono>

#include "model/accuracy_gate.h"
#include "proto/result.h"

namespace csipose {
namespace {

using Clock = std::chrono::steady_clock;

constexpr int kWarmUpWindows =
    5;  // for each number of whole receivers: primitives, pages and workers are then in place
constexpr std::size_t kGateWindows = 4;
/// A precision must be this much faster than the next more exact one; less is not worth its error, and would
/// let the choice hang on the noise of the timing.
constexpr double kWorthwhileSpeedUp = 1.15;

double milliseconds_since(Clock::time_point start) {
  return std::chrono::duration<double, std::milli>(Clock::now() - start).count();
}

/// Median time of the first layer of an encoder MLP on a full window: most of a window's arithmetic is like
/// it.
double time_mlp_product(const Model& model, Precision precision, const OneDnnOptions& options) {
  OneDnnContext context(options.threads, options.cpus);
  const Element element = number_plan(precision, context.cpu()).encoder;
  const std::size_t width = model.config().dim, hidden = 4 * width;
  const std::vector<float> weight(width * hidden, 0.5f), bias(hidden, 0.5f);
  Linear linear(context, {weight, bias}, {element, element, Epilogue::gelu}, "the timing of an MLP");
  linear.prepare(kTokens);
  const Buffer x(kTokens * width * size_of(element)), y(kTokens * hidden * size_of(element));
  std::array<double, 15> times_ms{};
  for (int warm_up = 0; warm_up < 5; ++warm_up) linear.run(x.data(), y.data(), kTokens);
  for (double& time_ms : times_ms) {
    const Clock::time_point start = Clock::now();
    linear.run(x.data(), y.data(), kTokens);
    time_ms = milliseconds_since(start);
  }
  std::nth_element(times_ms.begin(), times_ms.begin() + times_ms.size() / 2, times_ms.end());
  return times_ms[times_ms.size() / 2];
}

std::unique_ptr<OneDnnEngine> make(const std::shared_ptr<const Model>& model, Precision precision,
                                   const OneDnnOptions& options) {
  return std::make_unique<OneDnnEngine>(model, precision, options);
}

/// Takes the fastest precision that the processor has, that is worth it and that passes the gate. What was
/// decided, and why, goes to the notes.
class Choice {
 public:
  Choice(std::shared_ptr<const Model> model, const OneDnnOptions& options)
      : model_(std::move(model)), options_(options), cpu_(cpu_features()) {}

  std::unique_ptr<OneDnnEngine> take() {
    exact_ = make(model_, Precision::f32, options_);
    best_ms_ = time_mlp_product(*model_, Precision::f32, options_);
    note(fmt::format("f32 {:.2f} ms an MLP product", best_ms_));
    for (const Precision candidate : {Precision::bf16, Precision::int8}) consider(candidate);
    std::unique_ptr<OneDnnEngine> engine = best_ ? std::move(best_) : std::move(exact_);
    engine->add_note(notes_);
    return engine;
  }

 private:
  void consider(Precision candidate) {
    const std::string name(name_of(candidate));
    if (const auto reason = why_not(candidate, cpu_, *model_))
      return note(fmt::format("{} not taken: {}", name, *reason));
    const double time_ms = time_mlp_product(*model_, candidate, options_);
    if (time_ms * kWorthwhileSpeedUp > best_ms_)
      return note(fmt::format("{} not taken: {:.2f} ms", name, time_ms));
    std::unique_ptr<OneDnnEngine> engine = make(model_, candidate, options_);
    const GateFigures figures = figures_for(candidate, *engine);
    if (!passes_gate(figures)) return note(fmt::format("{} not taken: it {}", name, words_for(figures)));
    note(fmt::format("{} {:.2f} ms, {}", name, time_ms, words_for(figures)));
    best_ = std::move(engine);
    best_ms_ = time_ms;
  }

  /// From the model file; bf16 needs no calibration and is measured here when the file is silent.
  GateFigures figures_for(Precision candidate, OneDnnEngine& engine) {
    const auto recorded = model_->gate().find(std::string(name_of(candidate)));
    if (recorded != model_->gate().end()) return recorded->second;
    const std::vector<WindowTensor> windows =
        noise_windows(model_->normalisation(), kGateWindows, /*seed=*/1);
    return measure_shift(*exact_, engine, windows);
  }

  void note(const std::string& words) { notes_.append(notes_.empty() ? "" : "; ").append(words); }

  std::shared_ptr<const Model> model_;
  OneDnnOptions options_;
  CpuFeatures cpu_;
  std::unique_ptr<OneDnnEngine> exact_, best_;
  double best_ms_ = 0;
  std::string notes_;
};

/// A layer that has no int8 scale; empty when each has one.
std::string layer_without_scale(const Model& model) {
  for (std::size_t i = 0; i < model.config().depth; ++i)
    for (const char* linear : {"attn.qkv", "attn.proj", "mlp.fc1", "mlp.fc2"}) {
      const std::string layer = fmt::format("encoder.blocks.{}.{}", i, linear);
      if (model.calibration().int8_input_max.count(layer) == 0) return layer;
    }
  return {};
}

std::shared_ptr<const Model> checked(std::shared_ptr<const Model> model, Precision precision) {
  if (const auto reason = why_not(precision, cpu_features(), *model))
    throw SetupError(ExitStatus::unavailable,
                     fmt::format("precision {} is not possible: {}", name_of(precision), *reason));
  return model;
}

/// A precision that a person asked for is given even beyond the gate, but not in silence.
std::string gate_note(const Model& model, Precision precision) {
  const auto recorded = model.gate().find(std::string(name_of(precision)));
  if (recorded == model.gate().end() || passes_gate(recorded->second)) return {};
  return fmt::format("{} as asked, although it {}", name_of(precision), words_for(recorded->second));
}

}  // namespace

std::string_view name_of(Precision precision) {
  switch (precision) {
    case Precision::f32:
      return "f32";
    case Precision::bf16:
      return "bf16";
    case Precision::int8:
      break;
  }
  return "int8";
}

std::optional<std::string> why_not(Precision precision, const CpuFeatures& cpu, const Model& model) {
  switch (precision) {
    case Precision::f32:
      break;
    case Precision::bf16:
      if (!cpu.avx512_bf16)
        return fmt::format("this processor ({}) has no unit for bf16; take f32", to_string(cpu));
      break;
    case Precision::int8:
      if (!cpu.avx512_vnni)
        return fmt::format("this processor ({}) has no VNNI, without which int8 sums saturate; take f32",
                           to_string(cpu));
      if (model.calibration().int8_input_max.empty())
        return fmt::format("{} has no int8 calibration; make one with `csipose model calibrate`",
                           model.file_name());
      if (const std::string layer = layer_without_scale(model); !layer.empty())
        return fmt::format(
            "the int8 calibration of {} lacks {}; make a new one with `csipose model calibrate`",
            model.file_name(), layer);
      break;
  }
  return std::nullopt;
}

OneDnnEngine::OneDnnEngine(std::shared_ptr<const Model> model, Precision precision,
                           const OneDnnOptions& options)
    : model_(checked(std::move(model), precision)),
      precision_(precision),
      context_(options.threads, options.cpus),
      encoder_(context_, *model_, number_plan(precision, context_.cpu())),
      decoder_(context_, *model_, number_plan(precision, context_.cpu()), options.refined_queries) {
  for (std::size_t columns = 1; columns <= model_->config().token_grid().columns; ++columns) {
    encoder_.prepare(columns * kSamples);
    decoder_.prepare(columns * kSamples);
  }
  add_note(gate_note(*model_, precision));
}

NetworkOutput OneDnnEngine::infer(std::span<const float> x, LinkSet links, const Background* background) {
  context_.enter();
  probe_.start();
  const void* features = encoder_.run(x, links, background, probe_);
  return decoder_.run(features, model_->config().token_count(links), probe_);
}

void OneDnnEngine::run_encoder(std::span<const float> x, LinkSet links) {
  context_.enter();
  encoder_.run(x, links, nullptr, probe_);
}

void OneDnnEngine::warm_up() {
  const WindowTensor window = noise_windows(model_->normalisation(), 1, /*seed=*/1).front();
  for (LinkSet links(0b111); links.count() <= kLinks; links = links << kAntennas | LinkSet(0b111)) {
    const Clock::time_point start = Clock::now();
    for (int i = 0; i < kWarmUpWindows; ++i) run(window, links);
    add_note(fmt::format("{} links {:.2f} ms a window", links.count(),
                         milliseconds_since(start) / kWarmUpWindows));
    if (links.all()) break;
  }
}

std::string OneDnnEngine::describe() const {
  const dnnl_version_t* version = dnnl_version();
  const int threads = context_.threads().count();
  return fmt::format("oneDNN {}.{}.{}, {} ({}), {} thread{}", version->major, version->minor, version->patch,
                     name_of(precision_), encoder_.implementation(), threads, threads == 1 ? "" : "s");
}

void OneDnnEngine::add_note(const std::string& note) {
  if (!note.empty()) notes_.append(notes_.empty() ? "" : "; ").append(note);
}

std::unique_ptr<Engine> make_onednn_engine(std::shared_ptr<const Model> model, const OneDnnOptions& options) {
  require_engine_tokens(model->config());
  std::unique_ptr<OneDnnEngine> engine =
      options.precision ? make(model, *options.precision, options) : Choice(model, options).take();
  engine->warm_up();
  engine->probe().keep_stages = options.keep_stages;
  return engine;
}

}  // namespace csipose
