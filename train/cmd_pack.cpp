// csipose-train pack: a trained weights file as it ships.
#include <fmt/core.h>

#include <CLI/CLI.hpp>
#include <memory>
#include <string>
#include <vector>

#include "model/model.h"
#include "train/commands.h"
#include "train/pack.h"

namespace csipose::train {

void add_pack(CLI::App& app) {
  struct Options {
    std::string model, out;
    std::vector<std::string> installations;
  };
  auto options = std::make_shared<Options>();
  CLI::App* command = app.add_subcommand("pack", "a trained file as it ships: float16, nothing for training");
  command->add_option("--model", options->model, "weights, .safetensors")->required();
  command->add_option("--out", options->out, "file to write, replaced in one step")->required();
  command
      ->add_option("--installations", options->installations,
                   "of its backgrounds only those of these; all that it learnt in otherwise")
      ->type_name("NAME");
  command->callback([options] {
    SafetensorsFile file = SafetensorsFile::read(options->model);
    if (!options->installations.empty()) file = knowing_only(file, options->installations);
    const std::vector<std::uint8_t> bytes = pack_for_shipping(file, {});
    const auto model =
        Model::from(SafetensorsFile::parse(bytes, options->out));  // what cannot be read does not ship
    write_file_atomically(options->out, bytes);
    fmt::print("{}: {} bytes, sha256 {}\n", options->out, bytes.size(), model->digest());
  });
}

}  // namespace csipose::train
