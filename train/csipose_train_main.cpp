// csipose-train - windows and labels in, weights out.
#include <CLI/CLI.hpp>
#include <cstdio>

#include "proto/result.h"
#include "train/commands.h"
#include "version.h"

using csipose::ExitStatus;

int main(int argc, char** argv) {
  CLI::App app("csipose-train: learns people's poses from WiFi channel state");
  app.set_version_flag("--version", "csipose-train " CSIPOSE_VERSION " (" CSIPOSE_COMMIT ")");
  app.require_subcommand(1);
  csipose::train::add_dataset(app);
  csipose::train::add_pretrain(app);
  csipose::train::add_finetune(app);
  csipose::train::add_eval(app);
  csipose::train::add_calibrate(app);
  csipose::train::add_gate(app);
  csipose::train::add_experiment(app);
  csipose::train::add_pack(app);
  csipose::train::add_defaults(app);
  try {
    app.parse(argc, argv);
    return static_cast<int>(ExitStatus::ok);
  } catch (const CLI::ParseError& error) {
    return app.exit(error) == 0 ? static_cast<int>(ExitStatus::ok) : static_cast<int>(ExitStatus::usage);
  } catch (const csipose::SetupError& error) {
    std::fprintf(stderr, "csipose-train: %s\n", error.what());
    return static_cast<int>(error.status);
  } catch (const std::exception& error) {
    std::fprintf(stderr, "csipose-train: stopped: %s\n", error.what());
    return static_cast<int>(ExitStatus::runtime);
  }
}
