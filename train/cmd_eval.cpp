// csipose-train eval: what a weights file is worth on labelled windows, by the daemon's engine.
#include <fmt/core.h>
#include <unistd.h>

#include <CLI/CLI.hpp>
#include <algorithm>
#include <filesystem>
#include <fstream>
#include <memory>
#include <nlohmann/json.hpp>
#include <opencv2/imgcodecs.hpp>

#include "model/cpu.h"
#include "model/safetensors.h"
#include "proto/result.h"
#include "train/commands.h"
#include "train/engine_options.h"
#include "train/evaluation.h"
#include "train/evaluation_picture.h"
#include "train/evaluation_report.h"
#include "train/report_differences.h"

namespace csipose::train {
namespace {

constexpr std::size_t kSheetWindows = 12;
constexpr double kMostOff = 0.005;  // of a figure, from processor to processor

struct EvalOptions {
  std::string model, out, expected;
  std::vector<std::string> data, training;
  EngineOptions engine;
  bool drop_receivers = false;
};

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

nlohmann::ordered_json report_of(const EvalOptions& options, const Model& model, const Engine& engine,
                                 const std::vector<NamedFigures>& rows,
                                 const std::vector<TrivialFigures>& trivial) {
  return {{"model", model.file_name()},
          {"sha256", model.digest()},
          {"untrained", model.untrained()},
          {"engine", engine.describe()},
          {"data", options.data},
          {"training_data", options.training},
          {"results", results_json(rows, trivial)}};
}

/// Throws when the report that options.expected names says otherwise.
void compare_with_expected(const EvalOptions& options, const nlohmann::ordered_json& report) {
  std::ifstream file(options.expected);
  const auto expected = nlohmann::json::parse(file, nullptr, false);
  if (expected.is_discarded())
    throw SetupError(ExitStatus::no_input,
                     fmt::format("{} (--expect) is no report that eval --out has written", options.expected));
  const auto differences = report_differences(expected, nlohmann::json::parse(report.dump()), kMostOff);
  if (!differences.empty())
    throw SetupError(
        ExitStatus::runtime,
        fmt::format("the weights, their report and this evaluation disagree in {} places, first: {}. "
                    "If the weights or the data were meant to change, write {} anew",
                    differences.size(), differences.front(), options.expected));
  fmt::print("as {} says\n", options.expected);
}

void make_folder(const std::string& folder) {
  std::error_code error;
  std::filesystem::create_directories(folder, error);
  if (error)
    throw SetupError(ExitStatus::cannot_create,
                     fmt::format("{} cannot be made: {}", folder, error.message()));
}

/// What the pictures show of the answers with all links.
struct Seen {
  std::vector<std::size_t> windows;  ///< of the sheet
  std::vector<Answer> answers;
  std::vector<Detection> detections;

  void look(const Answer& answer) {
    detections.insert(detections.end(), answer.found.begin(), answer.found.end());
    if (std::binary_search(windows.begin(), windows.end(), answer.window)) answers.push_back(answer);
  }
};

void write_pictures(const EvalOptions& options, const EvaluationSet& set, const Seen& seen,
                    const std::vector<NamedMetrics>& by_count) {
  const std::string title =
      fmt::format("{} on {}", std::filesystem::path(options.model).filename().string(), set.windows->name());
  const std::filesystem::path folder = options.out;
  const auto write = [&](const char* name, const cv::Mat& picture) {
    std::vector<std::uint8_t> png;
    cv::imencode(".png", picture, png);
    write_file_atomically(folder / name, png);
  };
  write("skeletons.png", draw_sheet(seen.answers, title));
  write("joints.png", draw_joint_errors(seen.detections, title));
  write("counts.png", draw_error_by_count(by_count, title));
}

void run_eval(const EvalOptions& options) {
  const std::shared_ptr<const Model> model = Model::load(options.model);
  const EvaluationSet set = open_evaluation_sets(options.data);
  const EvaluationSet training = open_evaluation_sets(options.training);
  const std::unique_ptr<Engine> engine = make_engine(options.engine, model);
  fmt::print("{} ({}), {} windows of {}\n", options.model, engine->describe(), set.windows->size(),
             set.windows->name());
  const bool watched = ::isatty(STDERR_FILENO) == 1;
  if (!options.out.empty()) make_folder(options.out);  // better now than after an hour
  Seen seen{spread_windows(*set.windows, kSheetWindows), {}, {}};
  std::vector<NamedFigures> rows;
  for (const auto& [name, links] : link_choices(options.drop_receivers))
    rows.push_back({name, evaluate_model(*engine, *model, set, links, [&, what = name](const Answer& answer) {
                      if (rows.empty()) seen.look(answer);
                      if (watched && answer.window % 100 == 0)
                        fmt::print(stderr, "\r{} {}/{} ", what, answer.window, set.windows->size());
                    })});
  if (watched) fmt::print(stderr, "\r\033[K");
  const std::vector<TrivialFigures> trivial = evaluate_trivial(training, set, model->model_to_room());
  print_tables(rows, trivial);
  const nlohmann::ordered_json report = report_of(options, *model, *engine, rows, trivial);
  if (!options.expected.empty()) compare_with_expected(options, report);
  if (options.out.empty()) return;
  write_file_atomically(std::filesystem::path(options.out) / "metrics.json", ByteView(report.dump(1) + "\n"));
  std::vector<NamedMetrics> by_count = {{rows.front().name, rows.front().figures.detect}};
  for (const TrivialFigures& row : trivial)
    if (row.name == "mean_at_room" || row.name == "mean_at_root") by_count.push_back({row.name, row.detect});
  write_pictures(options, set, seen, by_count);
}

}  // namespace

void add_eval(CLI::App& app) {
  auto options = std::make_shared<EvalOptions>();
  CLI::App* command =
      app.add_subcommand("eval", "a weights file on labelled windows, by the daemon's engine");
  command->add_option("--model", options->model, "weights, .safetensors")->required();
  command->add_option("--data", options->data, "folders of windows with labels that were not trained on")
      ->required();
  command
      ->add_option("--train", options->training,
                   "folders of windows that were, in the same order of rooms: the mean poses come from them")
      ->required();
  command->add_option("--out", options->out, "folder for metrics.json and pictures");
  command->add_option(
      "--expect", options->expected,
      "metrics.json of another day: fails when the weights' digest or a figure is not as there");
  add_engine_options(*command, options->engine);
  command->add_flag("--drop-receivers", options->drop_receivers,
                    "also with each receiver, and each two, absent");
  command->callback([options] {
    bound_spinning();
    run_eval(*options);
  });
}

}  // namespace csipose::train
