// `csipose model init|show|verify|export`: weights files.
#include <fmt/format.h>

#include <CLI/CLI.hpp>
#include <cstdio>
#include <nlohmann/json.hpp>

#include "daemon/tool.h"
#include "model/model.h"
#include "model/onnx_graph.h"

namespace csipose {
namespace {

using nlohmann::ordered_json;

struct InitOptions {
  std::string preset, out;
  std::uint64_t seed = 0;
  bool parity = false, receiver_tokens = false, receiver_conditioning = false, random_heads = false,
       force = false;
};

void init(const InitOptions& options) {
  require_free(options.out, options.force);
  NetworkConfig config = preset_config(options.preset);
  config.identity_conditioning = config.query_conditioning = !options.parity;
  config.receiver_tokens = options.receiver_tokens;
  config.receiver_conditioning = options.receiver_conditioning;
  const auto heads = options.random_heads ? HeadInit::random : HeadInit::zero;
  write_file_atomically(options.out, random_weights(config, options.seed, heads));
  if (tool_options().quiet) return;
  fmt::print("{}: preset {}, {:.2f} M parameters, seed {}, UNTRAINED\n", options.out, config.preset,
             static_cast<double>(parameter_count(config)) / 1e6, options.seed);
  if (!options.random_heads)
    fmt::print(stderr, "It finds nobody until it is trained: the layers that place joints start at zero.\n");
}

ordered_json calibration_of(const Model& model) {
  const Calibration& from = model.calibration();
  ordered_json out;
  out["score"] = from.score ? ordered_json{{"a", from.score->a}, {"b", from.score->b}} : ordered_json();
  out["joint_scale"] = from.joint_scale ? ordered_json(*from.joint_scale) : ordered_json();
  out["confidence_knots"] = from.confidence ? kConfidenceKnots : 0;
  out["confidences"] = ordered_json::parse(model.provenance().confidences);
  out["int8_layers"] = from.int8_input_max.size();
  if (!model.gate().empty()) out["gate"] = ordered_json::parse(to_json(model.gate()));
  return out;
}

ordered_json description_of(const Model& model) {
  const Provenance& from = model.provenance();
  const WindowDemand& demand = model.demand();
  const Normalisation& norm = model.normalisation();
  ordered_json out;
  out["file"] = model.file_name();
  out["sha256"] = model.digest();
  out["untrained"] = model.untrained();
  out["preset"] = model.config().preset;
  out["config"] = ordered_json::parse(to_json(model.config()));
  out["parameters"] = parameter_count(model.config());
  out["stage"] = from.stage;
  out["step"] = from.step;
  out["seed"] = from.seed;
  out["git"] = from.git;
  out["corpus"] = from.corpus;
  out["metrics"] = ordered_json::parse(from.metrics);
  out["window"] = {{"rate_hz", demand.rate_hz},
                   {"phase", demand.phase},
                   {"amplitude", demand.amplitude},
                   {"min_links", demand.min_links}};
  out["norm"] = {{"amp_mean", norm.amp_mean}, {"amp_std", norm.amp_std}, {"ph_std", norm.ph_std}};
  for (const Background& background : norm.backgrounds) out["norm"]["backgrounds"].push_back(background.name);
  out["model_to_room"] = model.model_to_room();
  out["calibration"] = calibration_of(model);
  return out;
}

/// One line per fact; what is nested stays JSON.
void show_as_text(const ordered_json& description) {
  for (const auto& [key, value] : description.items())
    fmt::print("{:<14} {}\n", key, value.is_string() ? value.get<std::string>() : value.dump());
  if (description["untrained"])
    fmt::print("\nUNTRAINED: the numbers are random; whatever it says of people means nothing.\n");
}

void show(const std::string& file) {
  const ordered_json description = description_of(*Model::load(file));
  if (tool_options().json)
    fmt::print("{}\n", description.dump());
  else
    show_as_text(description);
}

void verify(const std::string& file, const std::string& sha256) {
  const auto model = Model::load(file);
  if (!sha256.empty() && sha256 != model->digest())
    throw SetupError(
        ExitStatus::bad_data,
        fmt::format("{} has the SHA-256 {}, not the {} that was asked for: it is whole, but another model",
                    file, model->digest(), sha256));
  if (tool_options().json)
    fmt::print(
        "{}\n",
        ordered_json{{"file", file}, {"sha256", model->digest()}, {"untrained", model->untrained()}}.dump());
  else if (!tool_options().quiet)
    fmt::print("{}: whole; every tensor fits preset {}; sha256 {}{}\n", file, model->config().preset,
               model->digest(), model->untrained() ? "; UNTRAINED" : "");
}

void export_onnx(const std::string& file, const std::string& out, bool force) {
  require_free(out, force);
  const auto model = Model::load(file);
  write_file_atomically(out, onnx_file(*model));
  if (!tool_options().quiet)
    fmt::print("{}: ONNX, opset 17, the network of {}{}\n", out, file,
               model->untrained() ? ", UNTRAINED" : "");
}

void add_init(CLI::App& model) {
  CLI::App* command = model.add_subcommand("init", "write random weights, marked UNTRAINED");
  auto options = std::make_shared<InitOptions>();
  command->add_option("--preset", options->preset, fmt::format("{}", fmt::join(preset_names(), ", ")))
      ->required();
  command->add_option("--out", options->out, "file to write")->required()->type_name("FILE");
  command->add_option("--seed", options->seed, "same seed, same file");
  CLI::Option* parity = command->add_flag("--parity", options->parity,
                                          "as published: refinement does not know whom it refines");
  CLI::Option* of_receivers =
      command
          ->add_flag("--receiver-tokens", options->receiver_tokens,
                     "a token is what a sample has of a receiver, its three links side by side")
          ->excludes(parity);
  command
      ->add_flag("--receiver-conditioning", options->receiver_conditioning,
                 "a link's token also has its receiver's other two links")
      ->excludes(parity)
      ->excludes(of_receivers);
  command->add_flag(
      "--random-heads", options->random_heads,
      "random numbers also where training starts at zero: for timing and for comparing engines");
  command->add_flag("--force", options->force, "replace a file that is there");
  command->callback([options] { init(*options); });
}

}  // namespace

void add_model(CLI::App& app) {
  CLI::App* model =
      app.add_subcommand("model", "weights files: init, show, verify, export, calibrate, background");
  model->require_subcommand(1);
  add_init(*model);
  auto file = std::make_shared<std::string>();
  auto sha256 = std::make_shared<std::string>();
  CLI::App* show_command = model->add_subcommand("show", "what a weights file says of itself");
  show_command->add_option("file", *file, "a .safetensors file")->required();
  show_command->callback([file] { show(*file); });
  CLI::App* verify_command =
      model->add_subcommand("verify", "check every byte and every tensor of a weights file");
  verify_command->add_option("file", *file, "a .safetensors file")->required();
  verify_command->add_option("--sha256", *sha256, "digest that the file must have")->type_name("HEX");
  verify_command->callback([file, sha256] { verify(*file, *sha256); });
  auto out = std::make_shared<std::string>();
  auto force = std::make_shared<bool>(false);
  CLI::App* export_command =
      model->add_subcommand("export", "write the network as an ONNX file, for other runtimes");
  export_command->add_option("file", *file, "a .safetensors file")->required();
  export_command->add_option("--out", *out, "ONNX file to write")->required()->type_name("FILE");
  export_command->add_flag("--force", *force, "replace a file that is there");
  export_command->callback([file, out, force] { export_onnx(*file, *out, *force); });
  add_calibrate(*model);
  add_background(*model);
}

}  // namespace csipose
