// train/parameters.h - a network's numbers while they are trained: float32 tensors by the names of docs/weights.md.
#pragma once

#include <cstdint>
#include <functional>
#include <map>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include "model/config.h"
#include "model/safetensors.h"
#include "train/torch.h"

namespace csipose::train {

/// Named tensors in the order in which they were added, which is the order of their file and of every sum over them.
class Parameters {
 public:
  /// Replaces a tensor of that name.
  void set(const std::string& name, at::Tensor tensor);
  bool has(std::string_view name) const { return index_.find(name) != index_.end(); }
  /// A name that is not there is a mistake of ours (assert): files are checked when they are read.
  const at::Tensor& operator[](std::string_view name) const;
  auto begin() const { return tensors_.begin(); }
  auto end() const { return tensors_.end(); }
  std::size_t size() const { return tensors_.size(); }

  /// Those whose name starts with `prefix`, the same tensors under the same names.
  Parameters under(std::string_view prefix) const;
  /// Copies under other names: `from`NAME becomes `to`NAME.
  Parameters renamed_copy(std::string_view from, std::string_view to) const;
  /// Adds all tensors of another.
  void merge(const Parameters& other);
  /// Numbers in all of them.
  std::int64_t count() const;
  void move_to(const at::Device& device);

 private:
  std::vector<std::pair<std::string, at::Tensor>> tensors_;
  std::map<std::string, std::size_t, std::less<>> index_;
};

/// The predictor's sizes; `paper` has 512 wide, 8 blocks, 16 heads.
struct PredictorShape {
  std::size_t dim = 0, depth = 0, heads = 0;
  TokenGrid grid{};
  bool operator==(const PredictorShape&) const = default;
};
/// For one token for each sample and link. Throws SetupError (usage) for a preset that there is not.
PredictorShape predictor_shape(std::string_view preset);
/// Tensors predictor.*, in the order of computation. `encoder_dim`: width of what it reads and predicts.
std::vector<TensorSpec> predictor_tensors(const PredictorShape& shape, std::size_t encoder_dim);

/// Everything the daemon computes with: encoder by N(0, 0.02), decoder by Xavier, last pose layers 0 (model/model.h,
/// HeadInit::zero). Same configuration and seed: same numbers.
Parameters initial_network(const NetworkConfig& config, std::uint64_t seed);
/// predictor.*: weights and mask token N(0, 0.02), biases 0, LayerNorm 1 and 0.
/// source: facebookresearch/ijepa, VisionTransformerPredictor
Parameters initial_predictor(const PredictorShape& shape, std::size_t encoder_dim, std::uint64_t seed);

/// predictor.ordered.*: tokens' mean to poses and presence of kOrderedPeople people (losses.h, ordered_loss). Fan-in, biases 0.
inline constexpr std::size_t kOrderedPeople = 3;
Parameters initial_ordered_head(std::size_t encoder_dim, std::uint64_t seed);

/// predictor.map.*: each token's evidence, and from its mean the `cells` of a floor (losses.h, map_loss). Fan-in, biases 0 and, of the
/// cells, -4: most are empty.
Parameters initial_map_head(std::size_t encoder_dim, std::size_t cells, std::uint64_t seed);

/// Brings the matrices of `prefix` from deviation 0.02, which suits a width of 768, to 1 / sqrt(inputs), so that a narrow
/// network's blocks and its embedding are heard beside the position code from the first step on.
/// source: LeCun et al., Efficient BackProp, 1998, section 4.6
void scale_to_fan_in(const Parameters& parameters, std::string_view prefix);

/// The file's floating-point tensors as float32 copies.
Parameters parameters_of(const SafetensorsFile& file);
/// Views of the tensors' memory as float32 for pack_safetensors; `kept` owns that memory.
std::vector<TensorView> views_of(const Parameters& parameters, std::vector<at::Tensor>& kept);

}  // namespace csipose::train
