// csipose-train eval: what a weights file is worth on labelled windows, by the daemon's engine.
#include <fmt/core.h>
#include <unistd.h>

#include <CLI/CLI.hpp>
#include <algorithm>
#include <cmath>
#include <filesystem>
#include <fstream>
#include <map>
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

struct NamedFigures {
  std::string name;
  Evaluation figures;
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

/// Not a number without any.
double percent(std::size_t part, std::size_t all) {
  return 100 * static_cast<double>(part) / static_cast<double>(all);
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

void print_head(const char* title, Protocol protocol) {
  fmt::print("\n{}\n{:16}{:>8}{:>8}{:>8}{:>8}{:>8}{:>8}{:>8}{:>9}", title, "", "MPJPE", "1", "2", "3", "PA",
             "PCK20", "PCK50", "pen.500");
  if (protocol == Protocol::detect) fmt::print("{:>8}{:>8}{:>8}", "prec.", "recall", "count");
  fmt::print("\n");
}

void print_stance(const std::string& name, const Metrics& metrics) {
  const PoseErrors mean = metrics.all().frame_mean;
  fmt::print("{:16}", name);
  for (const double figure :
       {mean.mpjpe, mean.mrpe, mean.root_mpjpe, mean.pa_mpjpe, mean.facing_deg, mean.breadth_mm})
    fmt::print("{:>9}", cell(figure));
  fmt::print("\n");
}

/// What of the error is where somebody is, and what is how he stands.
void print_stances(const std::vector<NamedFigures>& rows, const std::vector<TrivialFigures>& trivial) {
  fmt::print(
      "\nwhere and how somebody stands: piw3d; trivial answers assigned (mm, degrees)\n"
      "{:16}{:>9}{:>9}{:>9}{:>9}{:>9}{:>9}\n",
      "", "MPJPE", "root", "from it", "PA", "facing", "breadth");
  for (const NamedFigures& row : rows) print_stance(row.name, row.figures.piw3d);
  for (const TrivialFigures& row : trivial) print_stance(row.name, row.assigned);
}

/// The model by piw3d; beside it the mean pose at each person's true root.
void print_postures(const Evaluation& model, const std::vector<TrivialFigures>& trivial) {
  const Metrics& mean_at_root = std::ranges::find(trivial, "mean_at_root", &TrivialFigures::name)->assigned;
  fmt::print(
      "\nby how somebody stands: piw3d, over people (mm, degrees); recall by detect (%)\n"
      "{:16}{:>8}{:>8}{:>8}{:>8}{:>8}{:>8}{:>8}{:>14}\n",
      "", "people", "MPJPE", "root", "from it", "PA", "facing", "recall", "mean_at_root");
  for (std::size_t i = 0; i < kPostures; ++i) {
    const auto posture = static_cast<Posture>(i);
    const PostureMetrics group = model.piw3d.by_posture(posture), found = model.detect.by_posture(posture);
    const PoseErrors& mean = group.person_mean;
    fmt::print("{:16}{:>8}{:>8}{:>8}{:>8}{:>8}{:>8}{:>8}{:>14}\n", name_of(posture), group.people,
               cell(mean.mpjpe), cell(mean.mrpe), cell(mean.root_mpjpe), cell(mean.pa_mpjpe),
               cell(mean.facing_deg), cell(percent(found.matched, found.people)),
               cell(mean_at_root.by_posture(posture).person_mean.mpjpe));
  }
}

void print_tables(const std::vector<NamedFigures>& rows, const std::vector<TrivialFigures>& trivial) {
  print_head("detect: score 0.30, pose-NMS, pairs within 0.5 m (mm, %)", Protocol::detect);
  for (const NamedFigures& row : rows) print_row(row.name, row.figures.detect);
  print_head("piw3d: all hypotheses, no threshold, false positives cost nothing (mm, %)", Protocol::piw3d);
  for (const NamedFigures& row : rows) print_row(row.name, row.figures.piw3d);
  print_head("trivial answers, told how many people there are: optimal assignment, however far (mm, %)",
             Protocol::assigned);
  for (const TrivialFigures& row : trivial) print_row(row.name, row.assigned);
  print_head("trivial answers, pairs within 0.5 m only (mm, %)", Protocol::detect);
  for (const TrivialFigures& row : trivial) print_row(row.name, row.detect);
}

/// How far stated probabilities are from what came true; only rows that state some.
void print_reliability(const std::vector<NamedFigures>& rows) {
  fmt::print("\nexpected calibration error, ten bins, of what detect gives\n{:16}{:>8}{:>8}{:>8}{:>8}\n", "",
             "score", "people", "joints", "stated");
  const auto print_one = [](const Reliability& stated) {
    fmt::print("{:>8}{:>8}", stated.count() == 0 ? "-" : fmt::format("{:.4f}", stated.expected_error()),
               stated.count());
  };
  for (const NamedFigures& row : rows) {
    if (row.figures.score.count() == 0) continue;
    fmt::print("{:16}", row.name);
    print_one(row.figures.score);
    print_one(row.figures.joints);
    fmt::print("\n");
  }
}

/// Only of weights that know installations.
void print_installations(const std::vector<NamedFigures>& rows) {
  if (rows.front().figures.installations.windows == 0) return;
  fmt::print(
      "\nthe installation, from the windows of a clip so far (unlikeness; %)\n{:16}{:>8}{:>8}{:>9}{:>9}\n",
      "", "mean", "most", "unknown", "another");
  for (const NamedFigures& row : rows) {
    const Installations& of = row.figures.installations;
    fmt::print("{:16}{:>8.2f}{:>8.2f}{:>9}{:>9}\n", row.name,
               of.unlikeness_sum / static_cast<double>(of.windows), of.greatest_unlikeness,
               cell(percent(of.unknown, of.windows)), cell(percent(of.mistaken, of.named)));
  }
}

nlohmann::ordered_json installations_json(const Installations& of) {
  return {{"windows", of.windows},
          {"mean_unlikeness", of.unlikeness_sum / static_cast<double>(of.windows)},
          {"greatest_unlikeness", of.greatest_unlikeness},
          {"unknown_percent", percent(of.unknown, of.windows)},
          {"mistaken_percent", percent(of.mistaken, of.named)}};
}

nlohmann::ordered_json reliability_json(const Reliability& stated) {
  return {{"stated", stated.count()}, {"ece", stated.expected_error()}};
}

void put(nlohmann::ordered_json& results, const Metrics& metrics) {
  results[std::string(name_of(metrics.protocol()))] = nlohmann::ordered_json::parse(metrics_json(metrics));
}

nlohmann::ordered_json report_of(const EvalOptions& options, const Model& model, const Engine& engine,
                                 const std::vector<NamedFigures>& rows,
                                 const std::vector<TrivialFigures>& trivial) {
  nlohmann::ordered_json report;
  report["model"] = model.file_name();
  report["sha256"] = model.digest();
  report["untrained"] = model.untrained();
  report["engine"] = engine.describe();
  report["data"] = options.data;
  report["training_data"] = options.training;
  for (const NamedFigures& row : rows) {
    nlohmann::ordered_json& results = report["results"][row.name];
    put(results, row.figures.piw3d);
    put(results, row.figures.detect);
    if (row.figures.installations.windows > 0)
      results["installations"] = installations_json(row.figures.installations);
    if (row.figures.score.count() > 0) results["calibration"]["score"] = reliability_json(row.figures.score);
    if (row.figures.joints.count() > 0)
      results["calibration"]["joints"] = reliability_json(row.figures.joints);
  }
  for (const TrivialFigures& row : trivial) {
    nlohmann::ordered_json& results = report["results"][row.name];
    put(results, row.assigned);
    put(results, row.detect);
  }
  return report;
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
  print_stances(rows, trivial);
  print_postures(rows.front().figures, trivial);
  print_reliability(rows);
  print_installations(rows);
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
