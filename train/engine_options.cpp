#include "train/engine_options.h"

#include <CLI/CLI.hpp>
#include <map>

#include "model/model.h"
#include "proto/result.h"

namespace csipose::train {
namespace {

const std::map<std::string, Precision>& precisions() {
  static const std::map<std::string, Precision> names = {
      {"f32", Precision::f32}, {"bf16", Precision::bf16}, {"int8", Precision::int8}};
  return names;
}

}  // namespace

std::unique_ptr<Engine> make_engine(const EngineOptions& options, std::shared_ptr<const Model> model) {
  if (options.engine == "reference") {
    if (!options.precision.empty() && options.precision != "f32")
      throw SetupError(ExitStatus::usage, "the reference engine computes in f32 only; take --engine onednn");
    return make_reference_engine(std::move(model));
  }
  OneDnnOptions onednn;
  onednn.threads = options.threads;
  onednn.refined_queries = 0;  // piw3d looks at all
  if (!options.precision.empty()) onednn.precision = precisions().at(options.precision);
  return make_onednn_engine(std::move(model), onednn);
}

void add_engine_options(CLI::App& command, EngineOptions& options) {
  command.add_option("--engine", options.engine, "onednn or reference (slow, plain)")
      ->check(CLI::IsMember({"onednn", "reference"}));
  command
      .add_option("--precision", options.precision,
                  "f32, bf16 or int8; the fastest that passes its gate if not given")
      ->check(CLI::IsMember(precisions()));
  command.add_option("--threads", options.threads, "of the engine")->check(CLI::Range(1, 256));
}

}  // namespace csipose::train
