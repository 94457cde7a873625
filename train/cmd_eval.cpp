// csipose-train eval: what a weights file is worth on labelled windows, by the daemon's engine.
#include <fmt/core.h>
#include <unistd.h>

#include <CLI/CLI.hpp>
#include <cmath>
#include <filesystem>
#include <map>
#include <memory>
#include <nlohmann/json.hpp>

#include "model/engine.h"
#include "model/safetensors.h"
#include "proto/result.h"
#include "train/commands.h"
#include "train/evaluation.h"

namespace csipose::train {
namespace {

struct Options {
  std::string model, data, training, out, engine = "onednn", precision;
  int threads = 2;
  bool drop_receivers = false;
};

const std::map<std::string, Precision>& precisions() {
  static const std::map<std::string, Precision> names = {
      {"f32", Precision::f32}, {"bf16", Precision::bf16}, {"int8", Precision::int8}};
  return names;
}

std::unique_ptr<Engine> make_engine(const Options& options, std::shared_ptr<const Model> model) {
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

/// All links; with drop_receivers also every choice of one and of two receivers without theirs.
std::vector<std::pair<std::string, LinkSet>> link_choices(bool drop_receivers) {
  std::vector<std::pair<std::string, LinkSet>> choices = {{"model", LinkSet().set()}};
  if (!drop_receivers) return choices;
  for (const unsigned absent : {1u, 2u, 4u, 3u, 5u, 6u}) {
    LinkSet links = LinkSet().set();
    std::string name = "without";
    for (std::size_t r = 0; r < kReceivers; ++r) {
      if ((absent >> r & 1) == 0) continue;
      name += fmt::format(" rx{}", r);
      for (std::size_t a = 0; a < kAntennas; ++a) links.reset(r * kAntennas + a);
    }
    choices.emplace_back(name, links);
  }
  return choices;
}

std::string cell(double value) { return std::isnan(value) ? "-" : fmt::format("{:.1f}", value); }

void print_row(const std::string& name, const Metrics& metrics) {
  const GroupMetrics all = metrics.all();
  std::map<std::size_t, GroupMetrics> groups = metrics.by_count();
  fmt::print("{:16}", name);
  fmt::print("{:>8}", cell(all.frame_mean.mpjpe));
  for (const std::size_t count : {1u, 2u, 3u})
    fmt::print("{:>8}", groups.count(count) ? cell(groups[count].frame_mean.mpjpe) : "-");
  fmt::print("{:>8}{:>8}{:>8}", cell(all.frame_mean.pa_mpjpe), cell(all.frame_mean.pck20),
             cell(all.frame_mean.pck50));
  fmt::print("{:>9}", cell(all.penalised_500));
  if (metrics.protocol() == Protocol::detect)
    fmt::print("{:>8}{:>8}{:>8}", cell(100 * all.precision()), cell(100 * all.recall()),
               cell(100 * all.count_accuracy()));
  fmt::print("\n");
}

void print_table(Protocol protocol, const std::vector<NamedMetrics>& rows) {
  fmt::print("\n{}\n{:16}{:>8}{:>8}{:>8}{:>8}{:>8}{:>8}{:>8}{:>9}",
             protocol == Protocol::piw3d
                 ? "piw3d: all hypotheses, no threshold, false positives cost nothing (mm, %)"
                 : "detect: score 0.30, pose-NMS, pairs within 0.5 m (mm, %)",
             "", "MPJPE", "1", "2", "3", "PA", "PCK20", "PCK50", "pen.500");
  if (protocol == Protocol::detect) fmt::print("{:>8}{:>8}{:>8}", "prec.", "recall", "count");
  fmt::print("\n");
  for (const NamedMetrics& row : rows)
    print_row(row.name, protocol == Protocol::piw3d ? row.metrics.piw3d : row.metrics.detect);
}

void write_report(const Options& options, const Model& model, const Engine& engine,
                  const std::vector<NamedMetrics>& rows) {
  nlohmann::ordered_json report;
  report["model"] = model.file_name();
  report["sha256"] = model.digest();
  report["untrained"] = model.untrained();
  report["engine"] = engine.describe();
  report["data"] = options.data;
  report["training_data"] = options.training;
  for (const NamedMetrics& row : rows)
    for (const Metrics* metrics : {&row.metrics.piw3d, &row.metrics.detect}) {
      nlohmann::ordered_json json = nlohmann::ordered_json::parse(metrics_json(*metrics));
      report["results"][row.name][json["protocol"].get<std::string>()] = json;
    }
  std::error_code error;
  std::filesystem::create_directories(options.out, error);
  if (error)
    throw SetupError(ExitStatus::cannot_create,
                     fmt::format("{} cannot be made: {}", options.out, error.message()));
  write_file_atomically(std::filesystem::path(options.out) / "metrics.json", ByteView(report.dump(1) + "\n"));
}

void run(const Options& options) {
  const std::shared_ptr<const Model> model = Model::load(options.model);
  const EvaluationSet set = open_evaluation_set(options.data);
  const EvaluationSet training = open_evaluation_set(options.training);
  const std::unique_ptr<Engine> engine = make_engine(options, model);
  fmt::print("{} ({}), {} windows of {}\n", options.model, engine->describe(), set.windows->size(),
             options.data);
  const bool watched = ::isatty(STDERR_FILENO) == 1;
  std::vector<NamedMetrics> rows;
  for (const auto& [name, links] : link_choices(options.drop_receivers))
    rows.push_back({name, evaluate_model(*engine, *model, set, links, [&, what = name](std::size_t done) {
                      if (watched && done % 100 == 0)
                        fmt::print(stderr, "\r{} {}/{} ", what, done, set.windows->size());
                    })});
  if (watched) fmt::print(stderr, "\r\033[K");
  for (NamedMetrics& row : evaluate_trivial(training, set, model->model_to_room()))
    rows.push_back(std::move(row));
  print_table(Protocol::detect, rows);
  print_table(Protocol::piw3d, rows);
  if (!options.out.empty()) write_report(options, *model, *engine, rows);
}

}  // namespace

void add_eval(CLI::App& app) {
  auto options = std::make_shared<Options>();
  CLI::App* command =
      app.add_subcommand("eval", "a weights file on labelled windows, by the daemon's engine");
  command->add_option("--model", options->model, "weights, .safetensors")->required();
  command->add_option("--data", options->data, "folder of windows with labels that were not trained on")
      ->required();
  command
      ->add_option("--train", options->training, "folder of windows that were: the mean poses come from it")
      ->required();
  command->add_option("--out", options->out, "folder for metrics.json");
  command->add_option("--engine", options->engine, "onednn or reference (slow, plain)")
      ->check(CLI::IsMember({"onednn", "reference"}));
  command
      ->add_option("--precision", options->precision,
                   "f32, bf16 or int8; the fastest that passes its gate if not given")
      ->check(CLI::IsMember(precisions()));
  command->add_option("--threads", options->threads, "of the engine")->check(CLI::Range(1, 256));
  command->add_flag("--drop-receivers", options->drop_receivers,
                    "also with each receiver, and each two, absent");
  command->callback([options] { run(*options); });
}

}  // namespace csipose::train
