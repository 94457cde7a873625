// `csipose model calibrate`: int8 scales, and what lower precisions cost, into a copy of a weights file.
#include <fmt/format.h>

#include <CLI/CLI.hpp>
#include <cstdio>
#include <nlohmann/json.hpp>

#include "daemon/tool.h"
#include "model/calibrate.h"
#include "model/cpu.h"
#include "model/infer.h"

namespace csipose {
namespace {

struct CalibrateOptions {
  std::string model, windows, out;
  int threads = 2;
  bool force = false;
};

void print_figures(const std::string& precision, const GateFigures& figures) {
  if (tool_options().json) {
    const nlohmann::ordered_json line = {{"precision", precision},
                                         {"mean_joint_shift_m", figures.mean_joint_shift_m},
                                         {"max_joint_shift_m", figures.max_joint_shift_m},
                                         {"windows", figures.windows},
                                         {"allowed", passes_gate(figures)}};
    fmt::print("{}\n", line.dump());
  } else if (!tool_options().quiet) {
    fmt::print("{:<5} {}, over {} windows: {}\n", precision, words_for(figures), figures.windows,
               passes_gate(figures) ? "allowed" : "not taken by itself");
  }
}

void calibrate(const CalibrateOptions& options) {
  prepare_process_for_inference();
  require_free(options.out, options.force);
  const std::vector<WindowTensor> windows = read_window_file(options.windows);
  if (windows.empty())
    throw SetupError(ExitStatus::bad_data,
                     fmt::format("{} holds no window; calibration needs some", options.windows));
  const std::vector<std::uint8_t> bytes =
      calibrate_file(SafetensorsFile::read(options.model), windows, options.threads);
  const auto model = Model::from(SafetensorsFile::parse(bytes, options.out));
  write_file_atomically(options.out, bytes);
  for (const auto& [precision, figures] : model->gate()) print_figures(precision, figures);
}

}  // namespace

void add_calibrate(CLI::App& model_command) {
  CLI::App* command = model_command.add_subcommand(
      "calibrate", "allow faster arithmetic: measure int8 scales and what they cost");
  auto options = std::make_shared<CalibrateOptions>();
  command->add_option("model", options->model, "weights file")->required();
  command
      ->add_option("--tensors", options->windows,
                   "windows like those of later use, as 'csipose convert --tensor' writes")
      ->required()
      ->type_name("FILE");
  command->add_option("--out", options->out, "weights file to write")->required()->type_name("FILE");
  command->add_option("--threads", options->threads)->check(CLI::Range(1, 256));
  command->add_flag("--force", options->force, "replace a file that is there");
  command->callback([options] {
    bound_spinning();
    calibrate(*options);
  });
}

}  // namespace csipose
