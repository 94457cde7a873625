// `csipose model background`: what an installation shows on average, into a copy of a weights file.
#include <fmt/format.h>

#include <CLI/CLI.hpp>
#include <nlohmann/json.hpp>

#include "daemon/tool.h"
#include "model/background_meter.h"
#include "model/infer.h"
#include "model/model.h"

namespace csipose {
namespace {

struct Options {
  std::string model, windows, name, out;
  bool force = false;
};

void measure(const Options& options) {
  require_free(options.out, options.force);
  const SafetensorsFile file = SafetensorsFile::read(options.model);
  if (Model::from(file)->normalisation().backgrounds.empty())
    throw SetupError(
        ExitStatus::bad_data,
        fmt::format("{} scales its input by three numbers and takes no background off; a background "
                    "is of use to weights that were trained with data.norm = \"background\"",
                    options.model));
  BackgroundMeter meter;
  for (const auto& window : read_window_file(options.windows)) meter.add(window);
  const auto bytes = with_background(file, meter.background(options.name));
  const auto model = Model::from(SafetensorsFile::parse(bytes, options.out));
  write_file_atomically(options.out, bytes);
  std::vector<std::string> names;
  for (const Background& background : model->normalisation().backgrounds) names.push_back(background.name);
  if (tool_options().json)
    fmt::print(
        "{}\n",
        nlohmann::json{{"file", options.out}, {"windows", meter.windows()}, {"backgrounds", names}}.dump());
  else if (!tool_options().quiet)
    fmt::print("{}: knows {}; {} from {} windows\n", options.out, fmt::join(names, ", "), options.name,
               meter.windows());
}

}  // namespace

void add_background(CLI::App& model_command) {
  CLI::App* command = model_command.add_subcommand(
      "background",
      "tell weights what an installation shows on average: a room after its cards were powered up anew");
  auto options = std::make_shared<Options>();
  command->add_option("model", options->model, "weights file")->required();
  command
      ->add_option("--tensors", options->windows,
                   "a thousand windows or more, an hour apart rather than a minute, people moving about, as "
                   "'csipose convert --tensor' writes")
      ->required()
      ->type_name("FILE");
  command->add_option("--name", options->name, "of the installation; one of that name is replaced")
      ->required();
  command->add_option("--out", options->out, "weights file to write")->required()->type_name("FILE");
  command->add_flag("--force", options->force, "replace a file that is there");
  command->callback([options] { measure(*options); });
}

}  // namespace csipose
