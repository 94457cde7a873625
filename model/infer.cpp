#include "model/infer.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <deque>
#include <nlohmann/json.hpp>

#include "model/model.h"
#include "model/postprocess.h"
#include "proto/npy.h"
#include "proto/result.h"

namespace csipose {
namespace {

constexpr std::size_t kWindowNumbers = kChannels * kTokens;

std::vector<std::string> numbered(const char* name, std::size_t count) {
  std::vector<std::string> names;
  for (std::size_t i = 0; i < count; ++i) names.push_back(fmt::format("{}{}", name, i));
  return names;
}

bool starts_with(const std::string& text, std::string_view prefix) {
  return text.compare(0, prefix.size(), prefix) == 0;
}

NpyArray<float> read_windows(const std::filesystem::path& path, LinkSet links) {
  NpyArray<float> windows = read_npy<float>(path);
  if (windows.shape.size() == 3) windows.shape.insert(windows.shape.begin(), 1);
  if (windows.shape.size() != 4 || windows.shape[1] != kChannels || windows.shape[2] != kSamples ||
      windows.shape[3] != kLinks)
    throw SetupError(
        ExitStatus::bad_data,
        fmt::format("{} has shape ({}), but windows are (60, 20, 9) or (n, 60, 20, 9); make them with "
                    "'csipose convert RECORDING --tensor'",
                    path.string(), fmt::join(windows.shape, ", ")));
  for (std::size_t i = 0; i < windows.data.size(); ++i)
    if (links[i % kLinks] && !std::isfinite(windows.data[i]))
      throw SetupError(
          ExitStatus::bad_data,
          fmt::format("{}: window {} has a number that is not finite in link {}; leave that link out with "
                      "--absent-links {}",
                      path.string(), i / kWindowNumbers, i % kLinks, i % kLinks));
  return windows;
}

void make_folder(const std::filesystem::path& folder) {
  std::error_code failure;
  std::filesystem::create_directories(folder, failure);
  if (failure)
    throw SetupError(ExitStatus::cannot_create,
                     fmt::format("cannot make the folder {}: {}; name one where you may write",
                                 folder.string(), failure.message()));
}

/// The arrays that grow by a row with each window.
class Outputs {
 public:
  Outputs(const Model& model, const InferJob& job) : model_(model), job_(job) {
    const std::size_t queries = stage_shape(model.config(), job.links, "topk").front();
    open("logits", {queries});
    open("scores", {queries});
    open("poses", {queries, kJoints, 3});
    if (model.config().joint_sigma) open("sigma_m", {queries, kJoints});
    for (const std::string& stage : job.stages) open(stage, stage_shape(model.config(), job.links, stage));
  }

  void append(const NetworkOutput& output, const Engine& engine) {
    std::vector<float> scores;
    for (const float logit : output.logits) scores.push_back(person_score(logit, model_.calibration()));
    std::size_t next = 0;
    append(next++, output.logits);
    append(next++, scores);
    append(next++, output.poses);
    if (model_.config().joint_sigma) append(next++, output.sigma_m);
    for (const std::string& stage : job_.stages) append(next++, engine.stage(stage));
  }

  void finish() {
    for (Array& array : arrays_) array.writer.finish();
  }

  nlohmann::ordered_json shapes() const {
    nlohmann::ordered_json shapes;
    for (const Array& array : arrays_) {
      shapes[array.name] = {array.writer.rows()};
      for (const std::size_t extent : array.row) shapes[array.name].push_back(extent);
    }
    return shapes;
  }

 private:
  struct Array {
    Array(const std::filesystem::path& folder, std::string array_name, NpyShape row_shape)
        : name(std::move(array_name)), row(std::move(row_shape)), writer(folder / (name + ".npy"), row) {}
    std::string name;
    NpyShape row;
    NpyWriter<float> writer;
  };

  void open(const std::string& name, NpyShape row) {
    arrays_.emplace_back(job_.folder, name, std::move(row));
  }

  void append(std::size_t i, std::span<const float> numbers) {
    Array& array = arrays_[i];
    if (numbers.size() != element_count(array.row))
      throw SetupError(ExitStatus::usage,
                       fmt::format("this engine does not keep the stage '{}'; the reference engine keeps all "
                                   "(--engine reference)",
                                   array.name));
    array.writer.append(numbers);
  }

  const Model& model_;
  const InferJob& job_;
  std::deque<Array> arrays_;  // a writer does not move
};

const char* precision_name(Precision precision) {
  switch (precision) {
    case Precision::f32:
      return "f32";
    case Precision::bf16:
      return "bf16";
    case Precision::int8:
      return "int8";
  }
  return "";
}

void write_account(const Engine& engine, const Model& model, const InferJob& job, const Outputs& outputs) {
  nlohmann::ordered_json account;
  account["model"] = model.file_name();
  account["sha256"] = model.digest();
  account["untrained"] = model.untrained();
  account["engine"] = engine.describe();
  account["precision"] = precision_name(engine.precision());
  account["tensors"] = job.tensors.string();
  for (std::size_t l = 0; l < kLinks; ++l)
    if (job.links[l]) account["links"].push_back(l);
  account["arrays"] = outputs.shapes();
  write_file_atomically(job.folder / "infer.json", ByteView(account.dump(1) + "\n"));
}

void check_job(const Model& model, const InferJob& job) {
  if (job.links.none())
    throw SetupError(ExitStatus::usage,
                     "all nine links are said to be absent; leave at least one for the network");
  const std::vector<std::string> known = stage_names(model.config());
  for (const std::string& stage : job.stages)
    if (std::find(known.begin(), known.end(), stage) == known.end())
      throw SetupError(ExitStatus::usage, fmt::format("this network has no stage '{}'; it has {}", stage,
                                                      fmt::join(known, ", ")));
}

}  // namespace

std::vector<std::vector<float>> read_window_file(const std::filesystem::path& path) {
  const NpyArray<float> file = read_windows(path, LinkSet().set());
  std::vector<std::vector<float>> windows;
  for (auto first = file.data.begin(); first != file.data.end(); first += kWindowNumbers)
    windows.emplace_back(first, first + kWindowNumbers);
  return windows;
}

std::vector<std::string> stage_names(const NetworkConfig& config) {
  std::vector<std::string> names = {"embed"};
  const auto add = [&](const std::vector<std::string>& more) {
    names.insert(names.end(), more.begin(), more.end());
  };
  add(numbered("block", config.depth));
  add({"encoder", "memory", "enc_cls", "enc_kpt", "topk"});
  add(numbered("layer", config.decoder_layers));
  add({"cls", "kpt"});
  if (config.refine_layers > 0) add({"refined"});
  if (config.joint_sigma) add({"sigma"});
  return names;
}

std::vector<std::size_t> stage_shape(const NetworkConfig& config, LinkSet links, const std::string& stage) {
  const std::size_t tokens = config.token_count(links), queries = std::min(config.queries, tokens);
  if (stage == "memory") return {tokens, config.decoder_dim};
  if (stage == "enc_cls") return {tokens, 1};
  if (stage == "enc_kpt") return {tokens, kPoseWidth};
  if (stage == "topk") return {queries};
  if (starts_with(stage, "layer")) return {queries, config.decoder_dim};
  if (stage == "cls") return {config.decoder_layers, queries, 1};
  if (stage == "kpt") return {config.decoder_layers, queries, kPoseWidth};
  if (stage == "refined") return {config.refine_layers, queries, kJoints, 3};
  if (stage == "sigma") return {queries, kJoints};
  return {tokens, config.dim};  // embed, blocks, encoder
}

std::size_t infer_file(Engine& engine, const Model& model, const InferJob& job) {
  check_job(model, job);
  const NpyArray<float> windows = read_windows(job.tensors, job.links);
  make_folder(job.folder);
  Outputs outputs(model, job);
  for (std::size_t w = 0; w < windows.shape[0]; ++w) {
    const auto x = std::span(windows.data).subspan(w * kWindowNumbers, kWindowNumbers);
    outputs.append(engine.run(x, job.links), engine);
  }
  outputs.finish();
  write_account(engine, model, job, outputs);
  return windows.shape[0];
}

}  // namespace csipose
