// csipose-train gate: what lower precisions cost on labelled windows, into a weights file; the daemon chooses by it.
#include <fmt/core.h>

#include <CLI/CLI.hpp>
#include <memory>
#include <optional>

#include "model/accuracy_gate.h"
#include "model/cpu.h"
#include "model/onednn_engine.h"
#include "model/safetensors.h"
#include "proto/result.h"
#include "train/commands.h"
#include "train/engine_options.h"
#include "train/evaluation.h"

namespace csipose::train {
namespace {

struct GateOptions {
  std::string model, out;
  std::vector<std::string> data;
  int threads = 2;
};

double error_m(const GateOptions& options, const std::shared_ptr<const Model>& model,
               const EvaluationSet& set, const std::string& precision) {
  const auto engine = make_engine({"onednn", precision, options.threads}, model);
  return evaluate_model(*engine, *model, set, LinkSet().set()).piw3d.all().frame_mean.mpjpe / 1000;
}

void run_gate(const GateOptions& options) {
  const SafetensorsFile file = SafetensorsFile::read(options.model);
  const std::shared_ptr<const Model> model = Model::from(file);
  auto gate = model->gate();
  if (gate.empty())
    throw SetupError(
        ExitStatus::bad_data,
        fmt::format("{} was not prepared for lower precisions; csipose model calibrate does that first",
                    options.model));
  const EvaluationSet set = open_evaluation_sets(options.data);
  const double f32_m = error_m(options, model, set, "f32");
  fmt::print("{} windows of {}, piw3d: f32 {:.2f} mm\n", set.windows->size(), set.windows->name(),
             1000 * f32_m);
  for (auto& [precision, figures] : gate) {
    const Precision wanted = precision == "bf16" ? Precision::bf16 : Precision::int8;
    if (const auto reason = why_not(wanted, cpu_features(), *model)) {
      fmt::print("{:<5} left as it is: {}\n", precision, *reason);
      continue;
    }
    figures.labelled = {error_m(options, model, set, precision), f32_m, set.windows->size()};
    fmt::print("{:<5} {}: {}\n", precision, words_for(figures),
               passes_gate(figures) ? "allowed" : "not taken by itself");
  }
  const std::string target = options.out.empty() ? options.model : options.out;
  const auto bytes = with_gate(file, gate);
  Model::from(SafetensorsFile::parse(bytes, target));  // what is written can be read
  write_file_atomically(target, bytes);
}

}  // namespace

void add_gate(CLI::App& app) {
  auto options = std::make_shared<GateOptions>();
  CLI::App* command = app.add_subcommand(
      "gate",
      "lets the daemon choose bf16 or int8 where its error on labelled windows is at most 1 % above f32's");
  command->add_option("--model", options->model, "weights, .safetensors, after csipose model calibrate")
      ->required();
  command->add_option("--data", options->data, "folders of windows with labels that were not trained on")
      ->required();
  command->add_option("--out", options->out, "weights file to write; the model itself if not given");
  command->add_option("--threads", options->threads, "of the engine")->check(CLI::Range(1, 256));
  command->callback([options] {
    bound_spinning();
    run_gate(*options);
  });
}

}  // namespace csipose::train
