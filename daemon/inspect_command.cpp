// `csipose inspect FILE [--strict] [--png OUT]`: what is in a log or recording, and what is odd about it.
#include <CLI/CLI.hpp>
#include <cstdio>
#include <memory>

#include "daemon/csi_trace.h"
#include "daemon/draw.h"
#include "daemon/inspect.h"
#include "daemon/inspect_words.h"
#include "daemon/tool.h"

namespace csipose {
namespace {

struct InspectOptions {
  std::string file, png;
  bool strict = false;
};

void run_inspect(const InspectOptions& options) {
  const auto policy = options.strict ? RecordStream::Policy::strict : RecordStream::Policy::resynchronising;
  const Inspection inspection = inspect(options.file, policy);
  const std::string answer = tool_options().json ? to_json(inspection) : to_text(inspection);
  std::fwrite(answer.data(), 1, answer.size(), stdout);
  if (!options.png.empty()) draw_csi(trace_csi(options.file, kPictureColumns), options.png);
}

}  // namespace

void add_inspect(CLI::App& app) {
  const auto options = std::make_shared<InspectOptions>();
  CLI::App* command = app.add_subcommand(
      "inspect", "what is in a csitool log (.dat) or a recording (.mcap), and what is odd");
  command->add_option("file", options->file, "the log or recording")->required()->type_name("FILE");
  command->add_flag("--strict", options->strict, "end at the first framing error instead of searching on");
  command->add_option("--png", options->png, "also draw amplitude and sanitised phase over time")
      ->type_name("OUT");
  command->callback([options] { run_inspect(*options); });
}

}  // namespace csipose
