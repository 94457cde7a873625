// csipose-train finetune: learn people's poses from windows with labels.
#include <fmt/core.h>

#include <CLI/CLI.hpp>
#include <memory>

#include "model/cpu.h"
#include "train/commands.h"
#include "train/finetune.h"
#include "train/run_command.h"

namespace csipose::train {
namespace {

void run_finetune(const RunOptions& options) {
  const RunSettings settings = settings_of(options);
  prepare_machine(settings);
  const Workers workers = Workers::from_environment();
  Pool pool = open_data(settings);
  const Outcome outcome = finetune(settings, pool, workers);
  if (outcome.finished && workers.first())
    fmt::print("{}: best.safetensors and last.safetensors after {} steps\n", settings.run.out, outcome.steps);
}

}  // namespace

void add_finetune(CLI::App& app) {
  auto options = std::make_shared<RunOptions>();
  CLI::App* command = app.add_subcommand(
      "finetune",
      "learn people's poses from windows with labels; an interrupted run goes on where it stopped");
  add_run_options(*command, *options);
  command->callback([options] {
    bound_spinning();
    run_finetune(*options);
  });
}

}  // namespace csipose::train
