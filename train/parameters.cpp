#include "train/parameters.h"

#include <fmt/format.h>

#include <cassert>
#include <cmath>
#include <cstring>

#include "model/model.h"
#include "model/seeded_random.h"
#include "proto/result.h"
#include "proto/shape.h"

namespace csipose::train {
namespace {

constexpr double kInitialSigma = 0.02;  // facebookresearch/ijepa

at::Tensor tensor_of(const std::vector<std::size_t>& shape, const std::vector<float>& numbers) {
  const std::vector<std::int64_t> sizes(shape.begin(), shape.end());
  at::Tensor tensor = at::empty(sizes, at::kFloat);
  std::memcpy(tensor.data_ptr<float>(), numbers.data(), numbers.size() * sizeof(float));
  return tensor;
}

bool starts_with(std::string_view text, std::string_view begin) {
  return text.substr(0, begin.size()) == begin;
}
bool ends_with(std::string_view text, std::string_view end) {
  return text.size() >= end.size() && text.substr(text.size() - end.size()) == end;
}

void add_linear(std::vector<TensorSpec>& specs, const std::string& name, std::size_t out, std::size_t in) {
  specs.push_back({name + ".weight", {out, in}});
  specs.push_back({name + ".bias", {out}});
}
void add_norm(std::vector<TensorSpec>& specs, const std::string& name, std::size_t width) {
  specs.push_back({name + ".weight", {width}});
  specs.push_back({name + ".bias", {width}});
}

at::Tensor initial_tensor(const TensorSpec& spec, std::uint64_t seed) {
  const std::vector<std::int64_t> sizes(spec.shape.begin(), spec.shape.end());
  if (ends_with(spec.name, ".bias")) return at::zeros(sizes);
  if (spec.name.find("norm") != std::string::npos) return at::ones(sizes);
  at::Tensor tensor = at::empty(sizes, at::kFloat);
  SeededRandom random(seed, spec.name);
  float* numbers = tensor.data_ptr<float>();
  for (std::int64_t i = 0; i < tensor.numel(); ++i)
    numbers[i] = static_cast<float>(kInitialSigma * random.normal());
  return tensor;
}

}  // namespace

void Parameters::set(const std::string& name, at::Tensor tensor) {
  const auto found = index_.find(name);
  if (found != index_.end()) {
    tensors_[found->second].second = std::move(tensor);
    return;
  }
  index_[name] = tensors_.size();
  tensors_.emplace_back(name, std::move(tensor));
}

const at::Tensor& Parameters::operator[](std::string_view name) const {
  const auto found = index_.find(name);
  assert(found != index_.end());
  return tensors_[found->second].second;
}

Parameters Parameters::under(std::string_view prefix) const {
  Parameters some;
  for (const auto& [name, tensor] : tensors_)
    if (starts_with(name, prefix)) some.set(name, tensor);
  return some;
}

Parameters Parameters::renamed_copy(std::string_view from, std::string_view to) const {
  Parameters copies;
  for (const auto& [name, tensor] : tensors_)
    if (starts_with(name, from))
      copies.set(std::string(to) + name.substr(from.size()), tensor.detach().clone());
  return copies;
}

void Parameters::merge(const Parameters& other) {
  for (const auto& [name, tensor] : other) set(name, tensor);
}

void Parameters::move_to(const at::Device& device) {
  for (auto& [name, tensor] : tensors_) tensor = tensor.to(device);
}

std::int64_t Parameters::count() const {
  std::int64_t numbers = 0;
  for (const auto& [name, tensor] : tensors_) numbers += tensor.numel();
  return numbers;
}

PredictorShape predictor_shape(std::string_view preset) {
  static const std::map<std::string_view, PredictorShape> kShapes = {{"paper", {512, 8, 16}},
                                                                     {"base", {256, 4, 8}},
                                                                     {"small", {192, 3, 6}},
                                                                     {"tiny", {96, 2, 4}},
                                                                     {"micro", {48, 1, 4}}};
  const auto found = kShapes.find(preset);
  if (found == kShapes.end())
    throw SetupError(ExitStatus::usage,
                     fmt::format("there is no predictor for the preset '{}'; take one of {}", preset,
                                 fmt::join(preset_names(), ", ")));
  return found->second;
}

std::vector<TensorSpec> predictor_tensors(const PredictorShape& shape, std::size_t encoder_dim) {
  std::vector<TensorSpec> specs;
  add_linear(specs, "predictor.predictor_embed", shape.dim, encoder_dim);
  specs.push_back({"predictor.mask_token", {1, 1, shape.dim}});
  for (std::size_t i = 0; i < shape.depth; ++i) {
    const std::string block = fmt::format("predictor.predictor_blocks.{}.", i);
    add_norm(specs, block + "norm1", shape.dim);
    add_linear(specs, block + "attn.qkv", 3 * shape.dim, shape.dim);
    add_linear(specs, block + "attn.proj", shape.dim, shape.dim);
    add_norm(specs, block + "norm2", shape.dim);
    add_linear(specs, block + "mlp.fc1", 4 * shape.dim, shape.dim);
    add_linear(specs, block + "mlp.fc2", shape.dim, 4 * shape.dim);
  }
  add_norm(specs, "predictor.predictor_norm", shape.dim);
  add_linear(specs, "predictor.predictor_proj", encoder_dim, shape.dim);
  return specs;
}

Parameters initial_network(const NetworkConfig& config, std::uint64_t seed) {
  const auto model = init_random(config, seed, HeadInit::zero);
  Parameters parameters;
  for (const TensorSpec& spec : required_tensors(config))
    parameters.set(spec.name, tensor_of(spec.shape, model->tensors()[spec.name].data));
  return parameters;
}

Parameters initial_predictor(const PredictorShape& shape, std::size_t encoder_dim, std::uint64_t seed) {
  Parameters parameters;
  for (const TensorSpec& spec : predictor_tensors(shape, encoder_dim))
    parameters.set(spec.name, initial_tensor(spec, seed));
  return parameters;
}

Parameters initial_ordered_head(std::size_t encoder_dim, std::uint64_t seed) {
  constexpr std::size_t kHidden = 256;
  std::vector<TensorSpec> specs;
  add_linear(specs, "predictor.ordered.0", kHidden, encoder_dim);
  add_linear(specs, "predictor.ordered.2", kOrderedPeople * (kPoseWidth + 1), kHidden);
  Parameters parameters;
  for (const TensorSpec& spec : specs) parameters.set(spec.name, initial_tensor(spec, seed));
  scale_to_fan_in(parameters, "predictor.ordered.");
  return parameters;
}

Parameters initial_map_head(std::size_t encoder_dim, std::size_t cells, std::uint64_t seed) {
  constexpr std::size_t kHidden = 512;
  std::vector<TensorSpec> specs;
  add_linear(specs, "predictor.map.0", kHidden, encoder_dim);
  add_linear(specs, "predictor.map.2", cells, kHidden);
  Parameters parameters;
  for (const TensorSpec& spec : specs) parameters.set(spec.name, initial_tensor(spec, seed));
  scale_to_fan_in(parameters, "predictor.map.");
  parameters["predictor.map.2.bias"].fill_(-4);
  return parameters;
}

void scale_to_fan_in(const Parameters& parameters, std::string_view prefix) {
  const at::NoGradGuard no_gradients;
  for (const auto& [name, tensor] : parameters.under(prefix)) {
    if (tensor.dim() < 2 || name == "predictor.mask_token") continue;
    const auto inputs = static_cast<double>(tensor[0].numel());
    tensor.mul_(1 / (std::sqrt(inputs) * kInitialSigma));
  }
}

Parameters parameters_of(const SafetensorsFile& file) {
  Parameters parameters;
  for (const TensorView& view : file.tensors())
    if (is_floating_point(view.dtype)) parameters.set(view.name, tensor_of(view.shape, to_floats(view)));
  return parameters;
}

std::vector<TensorView> views_of(const Parameters& parameters, std::vector<at::Tensor>& kept) {
  std::vector<TensorView> views;
  for (const auto& [name, tensor] : parameters) {
    kept.push_back(tensor.detach().to(at::kCPU, at::kFloat).contiguous());
    const at::IntArrayRef sizes = kept.back().sizes();
    views.push_back({name, DType::f32, std::vector<std::size_t>(sizes.begin(), sizes.end()),
                     ByteView(kept.back().data_ptr<float>(), kept.back().nbytes())});
  }
  return views;
}

}  // namespace csipose::train
