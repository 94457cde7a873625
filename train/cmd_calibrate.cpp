// csipose-train calibrate: confidences that mean what they say, fitted on validation windows, into a weights file.
#include <fmt/core.h>

#include <CLI/CLI.hpp>
#include <algorithm>
#include <memory>
#include <nlohmann/json.hpp>

#include "model/cpu.h"
#include "model/safetensors.h"
#include "proto/result.h"
#include "train/commands.h"
#include "train/confidence_calibration.h"
#include "train/engine_options.h"

namespace csipose::train {
namespace {

struct CalibrateOptions {
  std::string model, out;
  std::vector<std::string> data;
  EngineOptions engine;
};

nlohmann::ordered_json account_of(const ConfidenceFit& fit, const EvaluationSet& set) {
  nlohmann::ordered_json account = {{"data", set.windows->name()},
                                    {"windows", set.windows->size()},
                                    {"found", fit.found},
                                    {"matched", fit.matched}};
  if (fit.found > 0)
    account["ece_score"] = {fit.score.before.expected_error(), fit.score.after.expected_error()};
  if (fit.joints.after.count() > 0)
    account["ece_joints"] = {fit.joints.before.expected_error(), fit.joints.after.expected_error()};
  return account;
}

void print_row(const char* what, const BeforeAndAfter& ece) {
  if (ece.after.count() == 0) return;
  fmt::print("{:18}{:>10}{:>10.4f}{:>10.4f}\n", what, ece.after.count(), ece.before.expected_error(),
             ece.after.expected_error());
}

void print_fit(const ConfidenceFit& fit) {
  fmt::print("expected calibration error, ten bins, on what it was fitted to\n{:18}{:>10}{:>10}{:>10}\n", "",
             "stated", "before", "after");
  print_row("person score", fit.score);
  print_row("joint confidence", fit.joints);
  const auto& [score, scale, curve, int8] = fit.calibration;
  if (score)
    fmt::print("score = sigmoid({:.4f} logit {:+.4f})\n", score->a, score->b);
  else
    fmt::print("score left as the network gives it: of {} found {} were there, and no rising curve fits\n",
               fit.found, fit.matched);
  if (scale)
    fmt::print("expected errors x {:.2f} to {:.2f}\n", *std::min_element(scale->begin(), scale->end()),
               *std::max_element(scale->begin(), scale->end()));
  else
    fmt::print("no joint confidences: {}\n", fit.matched == 0
                                                 ? "nobody was found who was there"
                                                 : "the network has no head for the expected error");
}

void run_calibrate(const CalibrateOptions& options) {
  const SafetensorsFile file = SafetensorsFile::read(options.model);
  const std::shared_ptr<const Model> model = Model::from(file);
  const EvaluationSet set = open_evaluation_sets(options.data);
  const std::unique_ptr<Engine> engine = make_engine(options.engine, model);
  std::vector<Detection> found, faint;
  ask_model(*engine, *model, set, LinkSet().set(), [&](const Answer& answer) {
    found.insert(found.end(), answer.found.begin(), answer.found.end());
    faint.insert(faint.end(), answer.faint.begin(), answer.faint.end());
  });
  fmt::print("{} ({}), {} windows of {}: {} people found\n", options.model, engine->describe(),
             set.windows->size(), set.windows->name(), found.size());
  const ConfidenceFit fit = fit_confidences(found, faint, model->calibration());
  if (!fit.calibration.score && !fit.calibration.joint_scale)
    throw SetupError(
        ExitStatus::bad_data,
        fmt::format("{} cannot be calibrated on {}: of {} people found {} were there; take more windows of "
                    "rooms like those it was trained on, or train it longer",
                    options.model, set.windows->name(), fit.found, fit.matched));
  const std::string target = options.out.empty() ? options.model : options.out;
  const auto bytes = with_confidences(file, fit.calibration, account_of(fit, set).dump());
  Model::from(SafetensorsFile::parse(bytes, target));  // what is written can be read
  write_file_atomically(target, bytes);
  print_fit(fit);
}

}  // namespace

void add_calibrate(CLI::App& app) {
  auto options = std::make_shared<CalibrateOptions>();
  CLI::App* command = app.add_subcommand(
      "calibrate",
      "person score and joint confidences that mean what they say, fitted on validation windows");
  command->add_option("--model", options->model, "weights, .safetensors")->required();
  command
      ->add_option("--data", options->data, "folders of windows with labels, neither trained nor tested on")
      ->required();
  command->add_option("--out", options->out, "weights file to write; the model itself if not given");
  add_engine_options(*command, options->engine);
  command->callback([options] {
    bound_spinning();
    run_calibrate(*options);
  });
}

}  // namespace csipose::train
