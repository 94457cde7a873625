// The untrained network of model.h.
#include <fmt/format.h>

#include <cmath>
#include <nlohmann/json.hpp>
#include <numeric>

#include "model/model.h"
#include "model/seeded_random.h"
#include "version.h"

namespace csipose {
namespace {

bool ends_with(std::string_view text, std::string_view end) {
  return text.size() >= end.size() && text.substr(text.size() - end.size()) == end;
}
bool contains(std::string_view text, std::string_view part) {
  return text.find(part) != std::string_view::npos;
}

/// The layer that says where a joint is, or how far it is to be moved.
bool is_last_pose_layer(std::string_view name) {
  return (contains(name, "kpt_branches") && !contains(name, "refine") && contains(name, ".6.")) ||
         (contains(name, "refine_kpt_branches") && contains(name, ".4."));
}

void fill_normal(std::vector<float>& data, SeededRandom& random, double sigma) {
  for (float& value : data) value = static_cast<float>(sigma * random.normal());
}

/// Glorot and Bengio 2010; shape is (out, in).
void fill_xavier(Tensor& tensor, SeededRandom& random) {
  const double bound = std::sqrt(6.0 / static_cast<double>(tensor.shape[0] + tensor.shape[1]));
  for (float& value : tensor.data) value = static_cast<float>(bound * (2 * random.uniform() - 1));
}

void fill_bias(std::string_view name, std::vector<float>& data, SeededRandom& random, HeadInit heads) {
  if (contains(name, "cls_branches"))
    std::fill(data.begin(), data.end(), -std::log(99.f));  // a query is a person once in a hundred
  else if (heads == HeadInit::random)
    fill_normal(data, random, 0.02);
}

Tensor random_tensor(const TensorSpec& spec, std::uint64_t seed, HeadInit heads) {
  const std::size_t count =
      std::accumulate(spec.shape.begin(), spec.shape.end(), std::size_t{1}, std::multiplies<>());
  Tensor tensor{spec.shape, std::vector<float>(count, 0.f)};
  const std::string_view name = spec.name;
  SeededRandom random(seed, name);
  const bool zero_layer =
      is_last_pose_layer(name) || contains(name, "refine_identity") || contains(name, "query_proposal");
  if (contains(name, "norm") && ends_with(name, ".weight"))
    std::fill(tensor.data.begin(), tensor.data.end(), 1.f);
  else if (zero_layer && heads == HeadInit::zero)
    return tensor;
  else if (ends_with(name, "bias"))
    fill_bias(name, tensor.data, random, heads);
  else if (ends_with(name, "query_embedding.weight"))
    fill_normal(tensor.data, random, 1);
  else if (contains(name, "encoder."))
    fill_normal(tensor.data, random, 0.02);
  else
    fill_xavier(tensor, random);
  return tensor;
}

std::map<std::string, std::string> untrained_metadata(const NetworkConfig& config, std::uint64_t seed) {
  const WindowDemand demand;
  return {{"format_version", "1"},
          {"preset", config.preset},
          {"config", to_json(config)},
          {"stage", "untrained"},
          {"step", "0"},
          {"seed", std::to_string(seed)},
          {"git", CSIPOSE_COMMIT},
          {"corpus", ""},
          {"metrics", "{}"},
          {"joint_order", nlohmann::json(kJointNames).dump()},
          {"model_to_room", nlohmann::json(kIdentityTransform).dump()},
          {"rate_hz", fmt::format("{}", demand.rate_hz)},
          {"phase", demand.phase},
          {"amplitude", demand.amplitude},
          // With random weights fewer links are as good as all of them; three are one whole receiver.
          {"min_links", "3"}};
}

}  // namespace

std::vector<std::uint8_t> random_weights(const NetworkConfig& config, std::uint64_t seed, HeadInit heads) {
  std::vector<TensorSpec> specs = required_tensors(config);
  std::vector<Tensor> tensors;
  for (const TensorSpec& spec : specs) tensors.push_back(random_tensor(spec, seed, heads));
  const Normalisation none;
  for (const auto& [name, value] :
       {std::pair("norm.amp_mean", none.amp_mean), std::pair("norm.amp_std", none.amp_std),
        std::pair("norm.ph_std", none.ph_std)}) {
    specs.push_back({name, {}});
    tensors.push_back({{}, {value}});
  }
  std::vector<TensorView> views;
  for (std::size_t i = 0; i < specs.size(); ++i)
    views.push_back({specs[i].name, DType::f32, specs[i].shape,
                     ByteView(tensors[i].data.data(), tensors[i].data.size() * sizeof(float))});
  return pack_safetensors(untrained_metadata(config, seed), views);
}

std::shared_ptr<const Model> init_random(const NetworkConfig& config, std::uint64_t seed, HeadInit heads) {
  const std::string name = fmt::format("random {} (seed {})", config.preset, seed);
  return Model::from(SafetensorsFile::parse(random_weights(config, seed, heads), name));
}

}  // namespace csipose
