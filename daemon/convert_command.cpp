// `csipose convert`: logs and recordings to NumPy arrays, logs to recordings.
#include <CLI/CLI.hpp>
#include <cstdio>
#include <memory>

#include "daemon/convert.h"
#include "daemon/tool.h"

namespace csipose {
namespace {

struct CommandOptions {
  std::vector<std::string> files;
  std::string npy, phase;
  bool tensor = false;
  ConvertOptions arrays;
  TensorOptions windows;
  bool keep_rotation = false, scaled = false, by_time = false;
};

void say(const std::string& words) {
  if (!tool_options().quiet) std::fprintf(stderr, "%s\n", words.c_str());
}

[[noreturn]] void misused(const std::string& words) {
  throw SetupError(ExitStatus::usage, words + " See csipose convert --help.");
}

void to_arrays(CommandOptions& options) {
  if (!options.phase.empty())
    options.arrays.phase = options.phase == "joint" ? PhaseMethod::joint : PhaseMethod::phasefi;
  options.arrays.undo_40mhz_rotation = !options.keep_rotation;
  const bool several = options.files.size() > 1;
  for (std::size_t i = 0; i < options.files.size(); ++i) {
    const std::filesystem::path folder = options.npy;
    convert_to_npy(options.files[i], several ? folder / ("rx" + std::to_string(i + 1)) : folder,
                   options.arrays);
  }
  say("arrays written to " + options.npy);
}

void to_windows(CommandOptions& options) {
  FrontEndConfig& front_end = options.windows.front_end;
  front_end.stream = options.arrays.stream;
  front_end.phase = options.phase == "phasefi" ? PhaseMethod::phasefi : PhaseMethod::joint;
  front_end.amplitude = options.scaled ? AmplitudeMethod::scaled : AmplitudeMethod::raw;
  front_end.align = options.by_time ? AlignMethod::time : AlignMethod::tx_counter;
  front_end.undo_40mhz_rotation = !options.keep_rotation;
  const std::size_t windows = convert_to_tensor(options.files, options.npy, options.windows);
  say(std::to_string(windows) + " windows written to " + options.npy);
}

void to_recording(const CommandOptions& options) {
  if (options.files.size() < 2 || !options.files.back().ends_with(".mcap"))
    misused("Name an output: --npy FOLDER, or as the last file a recording that ends in .mcap.");
  const std::vector<std::string> inputs(options.files.begin(), options.files.end() - 1);
  const std::uint64_t packets = convert_to_recording(inputs, options.files.back(), options.windows.rate_hz);
  say(std::to_string(packets) + " packets written to " + options.files.back());
}

void run_convert(CommandOptions& options) {
  if (options.npy.empty()) {
    if (options.tensor || !options.phase.empty())
      misused("--phase and --tensor write arrays: say where with --npy FOLDER.");
    return to_recording(options);
  }
  to_arrays(options);
  if (options.tensor) to_windows(options);
}

void add_window_options(CLI::App& command, CommandOptions& options) {
  FrontEndConfig& front_end = options.windows.front_end;
  command.add_flag("--tensor", options.tensor,
                   "also write the windows (n, 60, 20, 9); one to three files are receivers 1 to 3");
  command.add_flag("--scaled", options.scaled,
                   "windows with absolutely scaled amplitudes instead of raw ones");
  command.add_flag("--by-time", options.by_time,
                   "align receivers by their clocks, not by the transmit counter");
  command.add_option("--grid-hz", front_end.grid_hz, "samples per second in a window")
      ->check(CLI::Range(1.0, 5000.0))
      ->capture_default_str();
  command.add_option("--hop", front_end.hop, "samples from one window to the next")
      ->check(CLI::Range(1, 1000))
      ->capture_default_str();
  command.add_option("--max-gap", front_end.max_gap, "missing samples that are filled from an older one")
      ->check(CLI::Range(0, 19))
      ->capture_default_str();
  command
      .add_option("--rate-hz", options.windows.rate_hz,
                  "records per second of a .dat whose clock stands still")
      ->check(CLI::Range(0.1, 10000.0));
}

}  // namespace

void add_convert(CLI::App& app) {
  const auto options = std::make_shared<CommandOptions>();
  CLI::App* command =
      app.add_subcommand("convert", "logs and recordings to NumPy arrays, or logs to a recording");
  command
      ->add_option("files", options->files,
                   "one recording, or one to three .dat logs; last the .mcap to write, without --npy")
      ->required()
      ->expected(1, 4)
      ->type_name("FILE");
  command
      ->add_option("--npy", options->npy,
                   "write fields, csi_raw, csi_scaled and csi_scaled_sm as .npy into this folder")
      ->type_name("FOLDER");
  command->add_option("--phase", options->phase, "also write sanitised phases")
      ->check(CLI::IsMember({"joint", "phasefi"}))
      ->type_name("METHOD");
  command->add_option("--stream", options->arrays.stream, "space-time stream of phases and windows")
      ->check(CLI::Range(0, 2))
      ->capture_default_str();
  command->add_flag("--keep-rotation", options->keep_rotation,
                    "leave the 90 degrees on the upper half of 40 MHz, as other decoders do");
  add_window_options(*command, *options);
  command->callback([options] { run_convert(*options); });
}

}  // namespace csipose
