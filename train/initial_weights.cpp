#include "train/initial_weights.h"

#include <fmt/format.h>

#include <string>
#include <vector>

#include "proto/result.h"
#include "train/parameters.h"
#include "version.h"

namespace csipose::train {
namespace {

/// The bias of the proposals' last layer becomes the mean pose of the labels.
void set_proposal_bias(Weights& weights, const Pool& pool, std::span<const std::uint64_t> windows) {
  at::Tensor sum = at::zeros({kPoseWidth}, at::kDouble);
  std::int64_t people = 0;
  for (const std::uint64_t window : windows) {
    const People there = pool.people_of(std::span(&window, 1));
    sum += there.poses.to(at::kCPU).flatten(0, 1).sum(at::IntArrayRef{0}, false, at::kDouble);
    people += there.count[0];
  }
  if (people == 0)
    throw SetupError(ExitStatus::bad_data, "the data to fine-tune on has no labels: nobody is in it");
  weights.parameters[fmt::format("kpt_branches.{}.6.bias", weights.config.decoder_layers)].copy_(
      sum / static_cast<double>(people));
}

/// Has learnt of a link's channels alone, or of them and backgrounds, and goes where tokens begin with the same numbers and tell more.
bool is_widened(const std::string& name, const at::Tensor& from, const at::Tensor& to,
                const RunSettings& settings) {
  const NetworkConfig config = network_of(settings);
  const auto begins_with = [&](std::size_t numbers) {
    return from.size(1) == static_cast<std::int64_t>(numbers);
  };
  return name == "encoder.patch_embed.proj.weight" && from.size(0) == to.size(0) &&
         from.size(1) < to.size(1) && !config.receiver_tokens && !config.flat_tokens &&
         (begins_with(kChannels) || begins_with(config.link_numbers()));
}

[[noreturn]] void refuse_shape(const std::string& name, const RunSettings& settings) {
  throw SetupError(
      ExitStatus::bad_config,
      fmt::format(
          "{} (finetune.init) has '{}' of another shape, or for other tokens, than the preset {} with "
          "network.background_conditioning = {}, receiver_tokens = {}, "
          "receiver_conditioning = {} and flat_tokens = {}; "
          "set all of them as in that file",
          settings.finetune.init, name, settings.network.preset, settings.network.background_conditioning,
          settings.network.receiver_tokens, settings.network.receiver_conditioning,
          settings.network.flat_tokens));
}

/// Takes the encoder of a pre-trained file, or everything of a fine-tuned one.
void take_over(Weights& weights, const RunSettings& settings) {
  const Weights file = read_weights(settings.finetune.init);
  const std::string source = settings.finetune.init_from == "target" ? "target_encoder." : "encoder.";
  const bool whole = file.metadata.at("stage") == "finetuned" && source == "encoder.";
  std::size_t taken = 0;
  for (const auto& [name, to] : weights.parameters) {
    const bool encoder = name.rfind("encoder.", 0) == 0;
    const std::string theirs = encoder ? source + name.substr(8) : name;
    if ((!encoder && !whole) || name.rfind("norm.", 0) == 0 || !file.parameters.has(theirs)) continue;
    const at::Tensor& from = file.parameters[theirs];
    const bool fits = from.sizes() == to.sizes();
    if (!fits && name.rfind("predictor.map.", 0) == 0) continue;  // another floor is learned anew
    const bool other_tokens = encoder && file.config.receiver_tokens != weights.config.receiver_tokens;
    if (other_tokens || (!fits && !is_widened(name, from, to, settings))) refuse_shape(theirs, settings);
    if (fits)
      to.copy_(from);
    else
      to.zero_().narrow(1, 0, from.size(1)).copy_(from);
    taken += encoder;
  }
  if (taken == 0)
    throw SetupError(ExitStatus::bad_config,
                     fmt::format("{} (finetune.init) has no '{}'; it was not made by pretrain",
                                 settings.finetune.init, source));
  const auto corpus = file.metadata.find("corpus");
  if (corpus != file.metadata.end()) weights.metadata["corpus"] = corpus->second;
}

/// What weights have learnt from: what those learnt from that they began with, then this.
std::string corpus_after(const std::string& before, const std::string& now) {
  return before.empty() || before == now ? now : before + "; then " + now;
}

/// Fewest links that the network will have been trained with.
std::size_t min_links(const RunSettings& settings) {
  if (settings.finetune.lose_two_receivers > 0) return 3;
  if (settings.finetune.lose_receiver > 0 || settings.finetune.lose_links > 0) return 6;
  return kLinks;
}

}  // namespace

NetworkConfig network_of_poses(const RunSettings& settings) {
  NetworkConfig config = network_of(settings);
  config.joint_sigma = config.identity_conditioning && settings.finetune.sigma_epochs > 0;
  return config;
}

/// The floor that the people of these windows walk.
FloorGrid floor_of(const Pool& pool, std::span<const std::uint64_t> windows) {
  std::vector<float> numbers;
  for (const std::uint64_t window : windows)
    for (const Skeleton& person : pool.people(window))
      for (const Point3& hip : {person[kLeftHip], person[kRightHip]})
        numbers.insert(numbers.end(), {hip.x, hip.y, hip.z});
  if (numbers.empty())
    throw SetupError(ExitStatus::bad_data, "the data to fine-tune on has no labels: nobody is in it");
  const auto hips = static_cast<std::int64_t>(numbers.size() / 3);
  return FloorGrid::around(at::from_blob(numbers.data(), {hips, 3}, at::kFloat));
}

Weights initial_weights(const RunSettings& settings, const Pool& pool, std::span<const std::uint64_t> train,
                        const Numerics& numerics) {
  Weights weights =
      untrained_weights(network_of_poses(settings), static_cast<std::uint64_t>(settings.run.seed));
  if (settings.network.init == "fan_in") scale_to_fan_in(weights.parameters, "encoder.");
  if (settings.finetune.proposal_bias) set_proposal_bias(weights, pool, train);
  if (settings.finetune.ordered > 0) {
    weights.parameters.merge(
        initial_ordered_head(weights.config.dim, static_cast<std::uint64_t>(settings.run.seed)));
    const at::Tensor mean_pose =
        weights.parameters[fmt::format("kpt_branches.{}.6.bias", weights.config.decoder_layers)];
    weights.parameters["predictor.ordered.2.bias"]
        .view({static_cast<std::int64_t>(kOrderedPeople), kPoseWidth + 1})
        .narrow(1, 0, kPoseWidth)
        .copy_(mean_pose);
  }
  if (settings.finetune.map > 0) {
    const auto cells = static_cast<std::size_t>(floor_of(pool, train).cells());
    weights.parameters.merge(
        initial_map_head(weights.config.dim, cells, static_cast<std::uint64_t>(settings.run.seed)));
  }
  if (!settings.finetune.init.empty() && settings.finetune.init_from != "none") take_over(weights, settings);
  set_normalisation(weights, pool.scaling().front());
  weights.metadata["stage"] = "finetuned";
  weights.metadata["git"] = CSIPOSE_COMMIT;
  weights.metadata["corpus"] = corpus_after(weights.metadata["corpus"], pool.describe());
  weights.metadata["run"] = to_toml(settings, false);
  weights.metadata["numerics"] = numerics.matmul == at::kBFloat16 ? "bf16" : "f32";
  weights.metadata["min_links"] = std::to_string(min_links(settings));
  weights.metadata["progress"] = "{}";
  return weights;
}

}  // namespace csipose::train
