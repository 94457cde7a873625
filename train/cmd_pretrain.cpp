// csipose-train pretrain: pre-train an encoder on windows without labels (WiFi-JEPA).
#include <fmt/core.h>

#include <CLI/CLI.hpp>
#include <memory>

#include "model/cpu.h"
#include "train/commands.h"
#include "train/pretrain.h"
#include "train/run_command.h"

namespace csipose::train {
namespace {

void run_pretrain(const RunOptions& options) {
  const RunSettings settings = settings_of(options);
  prepare_machine(settings);
  const Workers workers = Workers::from_environment();
  Pool pool = open_data(settings);
  const Outcome outcome = pretrain(settings, pool, workers);
  if (outcome.finished && workers.first())
    fmt::print("{}: pretrained.safetensors after {} steps\n", settings.run.out, outcome.steps);
}

}  // namespace

void add_pretrain(CLI::App& app) {
  auto options = std::make_shared<RunOptions>();
  CLI::App* command = app.add_subcommand("pretrain",
                                         "pre-train an encoder on windows without labels (WiFi-JEPA); an "
                                         "interrupted run goes on where it stopped");
  add_run_options(*command, *options);
  command->callback([options] {
    bound_spinning();
    run_pretrain(*options);
  });
}

}  // namespace csipose::train
