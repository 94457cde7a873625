// `csipose infer`: a model over a file of windows, every stage of it when asked.
#include <fmt/format.h>

#include <CLI/CLI.hpp>
#include <cstdio>
#include <map>

#include "daemon/tool.h"
#include "model/cpu.h"
#include "model/infer.h"
#include "model/model.h"

namespace csipose {
namespace {

struct InferOptions {
  std::string model, tensors, out, engine = "onednn", precision;
  std::vector<std::size_t> absent_links;
  std::vector<std::string> stages;
  int threads = 2;
};

const std::map<std::string, Precision>& precisions() {
  static const std::map<std::string, Precision> names = {
      {"f32", Precision::f32}, {"bf16", Precision::bf16}, {"int8", Precision::int8}};
  return names;
}

std::unique_ptr<Engine> make_engine(const InferOptions& options, std::shared_ptr<const Model> model) {
  if (options.engine == "reference") {
    if (!options.precision.empty() && options.precision != "f32")
      throw SetupError(
          ExitStatus::usage,
          fmt::format("the reference engine computes in f32 only, not in {}; take --engine onednn",
                      options.precision));
    return make_reference_engine(std::move(model));
  }
  OneDnnOptions onednn;
  onednn.threads = options.threads;
  onednn.keep_stages = !options.stages.empty();
  onednn.refined_queries = 0;  // all, as the reference engine gives them
  if (!options.precision.empty()) onednn.precision = precisions().at(options.precision);
  return make_onednn_engine(std::move(model), onednn);
}

void infer(const InferOptions& options) {
  prepare_process_for_inference();
  const auto model = Model::load(options.model);
  InferJob job{options.tensors, options.out, LinkSet().set(), options.stages};
  for (const std::size_t link : options.absent_links) job.links.reset(link);
  if (job.stages == std::vector<std::string>{"all"}) job.stages = stage_names(model->config());
  const auto engine = make_engine(options, model);
  const std::size_t windows = infer_file(*engine, *model, job);
  if (!tool_options().quiet)
    fmt::print(stderr, "{} windows through {}{}; answers in {}\n", windows, engine->describe(),
               model->untrained() ? ", UNTRAINED weights" : "", options.out);
}

}  // namespace

void add_infer(CLI::App& app) {
  CLI::App* command = app.add_subcommand("infer", "run a model over windows in a NumPy file");
  auto options = std::make_shared<InferOptions>();
  command
      ->add_option("tensors", options->tensors,
                   "float32 (60, 20, 9) or (n, 60, 20, 9), as 'csipose convert --tensor' writes")
      ->required();
  command->add_option("--model", options->model, "weights file")->required()->type_name("FILE");
  command->add_option("--out", options->out, "folder for logits, scores, poses and stages")
      ->required()
      ->type_name("DIR");
  command->add_option("--engine", options->engine, "onednn or reference (slow, plain)")
      ->check(CLI::IsMember({"onednn", "reference"}));
  command
      ->add_option("--precision", options->precision,
                   "f32, bf16 or int8; without it the fastest that model and processor allow")
      ->check(CLI::IsMember(precisions()));
  command->add_option("--threads", options->threads, "threads of the oneDNN engine")
      ->check(CLI::Range(1, 256));
  command
      ->add_option("--absent-links", options->absent_links,
                   "links 0..8 (3 receiver + antenna) to leave out: 3,4,5")
      ->delimiter(',')
      ->check(CLI::Range(0, 8));
  command->add_option("--stages", options->stages, "stages to write too: embed, block0, .., or all")
      ->delimiter(',');
  command->callback([options] {
    bound_spinning();
    infer(*options);
  });
}

}  // namespace csipose
