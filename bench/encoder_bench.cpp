// encoder_bench - latency of encoder and whole network, and what the machine allows.
//
// Per preset, precision and thread count: median, p99, p99.9 and minimum of the encoder alone and of the
// whole network, and the bound: the same matrix products (with the fused GELU) and nothing else, each on its
// own weights as in the network, since a benchmark that reuses one weight matrix finds it in the cache and
// lies.
//
// Windows of all nine links. With --window FILE.f32 (60 x 20 x 9 float32) and --output FILE.f32 the last
// answer's poses are written, so that another program can be shown to compute the same network.
#include <fmt/format.h>

#include <CLI/CLI.hpp>
#include <algorithm>
#include <chrono>
#include <cstdio>
#include <fstream>
#include <functional>
#include <stdexcept>
#include <thread>

#include "model/accuracy_gate.h"
#include "model/calibrate.h"
#include "model/cpu.h"
#include "model/onednn_engine.h"

namespace csipose {
namespace {

using Clock = std::chrono::steady_clock;

struct Options {
  std::string model;
  std::vector<std::string> presets = {"paper"}, precisions = {"f32", "bf16", "int8"};
  std::vector<int> threads = {1, 2};
  int runs = 200, absent_receivers = 0;
  double paced_ms = 0;
  std::string window, output;
  bool json = false;
};

struct Latency {
  double minimum_ms, median_ms, p99_ms, p999_ms;
};

Latency summary(std::vector<double> times_ms) {
  std::sort(times_ms.begin(), times_ms.end());
  const auto quantile = [&](double q) {
    return times_ms[std::min(times_ms.size() - 1,
                             static_cast<std::size_t>(q * static_cast<double>(times_ms.size())))];
  };
  return {times_ms.front(), quantile(0.5), quantile(0.99), quantile(0.999)};
}

/// 20 warm-ups, then `runs` timed ones; with a pace, each starts on a steady tick after a sleep as in the
/// daemon's loop.
Latency measure(const Options& options, const std::function<void()>& work) {
  std::vector<double> times_ms;
  for (int i = 0; i < 20; ++i) work();
  Clock::time_point tick = Clock::now();
  for (int i = 0; i < options.runs; ++i) {
    if (options.paced_ms > 0) {
      tick += std::chrono::duration_cast<Clock::duration>(
          std::chrono::duration<double, std::milli>(options.paced_ms));
      std::this_thread::sleep_until(tick);
    }
    const Clock::time_point start = Clock::now();
    work();
    times_ms.push_back(std::chrono::duration<double, std::milli>(Clock::now() - start).count());
  }
  return summary(std::move(times_ms));
}

std::vector<int> first_processors(int count) {
  std::vector<int> cpus;
  for (int cpu = 0; cpu < count; ++cpu) cpus.push_back(cpu);
  return cpus;
}

/// All products of the encoder's blocks, D and 4 D wide, each with weights of its own.
class ProductsOnly {
 public:
  ProductsOnly(const NetworkConfig& config, Precision precision, int threads, std::size_t tokens)
      : context_(threads, first_processors(threads)), tokens_(tokens) {
    const Element e = number_plan(precision, context_.cpu()).encoder;
    const std::size_t width = config.dim;
    x_ = Buffer(tokens * 4 * width * sizeof(float));
    y_ = Buffer(tokens * 4 * width * sizeof(float));
    for (std::size_t block = 0; block < config.depth; ++block) {
      for (int i = 0; i < 4; ++i) add(width, width, {e, Element::f32, Epilogue::none});
      add(width, 4 * width, {e, e, Epilogue::gelu});
      add(4 * width, width, {e, Element::f32, Epilogue::none});
    }
  }
  void run() {
    context_.enter();
    for (Linear& linear : linears_) linear.run(x_.data(), y_.data(), tokens_);
  }

 private:
  void add(std::size_t inputs, std::size_t outputs, const LinearPlan& plan) {
    const std::vector<float> weight(inputs * outputs, 0.01f), bias(outputs, 0.01f);
    linears_.emplace_back(context_, LinearWeights{weight, bias}, plan, "bound").prepare(tokens_);
  }

  OneDnnContext context_;
  std::size_t tokens_;
  Buffer x_, y_;
  std::vector<Linear> linears_;
};

/// Random weights with random heads and an int8 calibration on noise: speed does not depend on the numbers.
std::shared_ptr<const Model> random_model(const std::string& preset) {
  const auto file =
      SafetensorsFile::parse(random_weights(preset_config(preset), 1, HeadInit::random), preset);
  const std::vector<WindowTensor> windows = noise_windows({}, 2, 1);
  const auto input_max = calibrate_int8(Model::from(file), windows, /*threads=*/1).input_max;
  return Model::from(SafetensorsFile::parse(with_int8_calibration(file, input_max, {}), preset));
}

WindowTensor window_of(const Options& options, const Model& model) {
  WindowTensor x = noise_windows(model.normalisation(), 1, 1).front();
  if (options.window.empty()) return x;
  std::ifstream file(options.window, std::ios::binary);
  if (!file.read(reinterpret_cast<char*>(x.data()), static_cast<std::streamsize>(x.size() * sizeof(float))))
    throw std::runtime_error(options.window + " does not hold 60 x 20 x 9 float32 numbers");
  return x;
}

void write_floats(const std::string& path, std::span<const float> values) {
  std::ofstream file(path, std::ios::binary);
  file.write(reinterpret_cast<const char*>(values.data()), static_cast<std::streamsize>(values.size_bytes()));
  if (!file.flush()) throw std::runtime_error("cannot write " + path);
}

void print(const Options& options, const std::string& preset, Precision precision, int threads,
           const char* what, const Latency& l) {
  const char* format =
      options.json
          ? "{{\"preset\":\"{}\",\"precision\":\"{}\",\"threads\":{},\"what\":\"{}\",\"median_ms\":{:.3f},"
            "\"p99_ms\":{:.3f},\"p999_ms\":{:.3f},\"minimum_ms\":{:.3f}}}\n"
          : "{:8} {:5} {} thread(s) {:8} median {:8.3f}  p99 {:8.3f}  p99.9 {:8.3f}  least {:8.3f} ms\n";
  fmt::print(fmt::runtime(format), preset, name_of(precision), threads, what, l.median_ms, l.p99_ms,
             l.p999_ms, l.minimum_ms);
  std::fflush(stdout);
}

void bench(const Options& options, const std::string& preset, const std::shared_ptr<const Model>& model,
           Precision precision, int threads) {
  if (const auto reason = why_not(precision, cpu_features(), *model))
    return fmt::print("{}: {}\n", name_of(precision), *reason);
  OneDnnOptions engine_options;
  engine_options.threads = threads;
  engine_options.cpus = first_processors(threads);
  OneDnnEngine engine(model, precision, engine_options);
  const WindowTensor x = window_of(options, *model);
  const LinkSet links(0b111111111u >> kAntennas * static_cast<unsigned>(options.absent_receivers));
  if (!options.json) fmt::print("{}: {}\n", preset, engine.describe());
  ProductsOnly products(model->config(), precision, threads, model->config().token_count(links));
  print(options, preset, precision, threads, "bound", measure(options, [&] { products.run(); }));
  print(options, preset, precision, threads, "encoder",
        measure(options, [&] { engine.run_encoder(x, links); }));
  print(options, preset, precision, threads, "network", measure(options, [&] { engine.run(x, links); }));
  if (!options.output.empty()) {
    engine.probe().keep_stages = true;
    engine.run(x, links);
    write_floats(options.output, engine.stage("encoder"));
  }
}

Precision precision_of(const std::string& name) {
  for (const Precision precision : {Precision::f32, Precision::bf16, Precision::int8})
    if (name == name_of(precision)) return precision;
  throw std::runtime_error("there is no precision '" + name + "'; take f32, bf16 or int8");
}

void bench_all(const Options& options) {
  prepare_process_for_inference();
  for (const std::string& preset : options.presets) {
    const auto model = options.model.empty() ? random_model(preset) : Model::load(options.model);
    for (const std::string& precision : options.precisions)
      for (const int threads : options.threads)
        bench(options, preset, model, precision_of(precision), threads);
  }
}

}  // namespace
}  // namespace csipose

int main(int argc, char** argv) try {
  csipose::bound_spinning();
  csipose::Options options;
  CLI::App app("latency of encoder and whole network");
  app.add_option("--model", options.model, "weights file in the place of random weights");
  app.add_option("--presets", options.presets)->delimiter(',');
  app.add_option("--precisions", options.precisions)->delimiter(',');
  app.add_option("--threads", options.threads)->delimiter(',');
  app.add_option("--runs", options.runs)->check(CLI::PositiveNumber);
  app.add_option("--absent-receivers", options.absent_receivers)->check(CLI::Range(0, 2));
  app.add_option("--paced", options.paced_ms,
                 "milliseconds between starts, asleep between them; 0: one after the other");
  app.add_option("--window", options.window, "raw float32 input");
  app.add_option("--output", options.output, "raw float32 output of the encoder, of the last combination");
  app.add_flag("--json", options.json, "one JSON object a line");
  CLI11_PARSE(app, argc, argv);
  csipose::bench_all(options);
} catch (const std::exception& error) {
  std::fprintf(stderr, "encoder_bench: %s\n", error.what());
  return 1;
}
