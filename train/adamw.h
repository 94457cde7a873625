// train/adamw.h - AdamW (Loshchilov and Hutter, 2019) whose state has names, so that a run goes on to the same bits.
#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include "train/parameters.h"

namespace csipose::train {

/// Parameters that share a learning rate and a weight decay.
struct ParameterGroup {
  Parameters parameters;
  double lr_factor = 1;  ///< of the run's learning rate
  double weight_decay = 0;
};

class AdamW {
 public:
  AdamW(std::vector<ParameterGroup> groups, double beta1 = 0.9, double beta2 = 0.999, double epsilon = 1e-8);

  void clear_gradients();
  /// One step with the parameters' gradients; those without one stay as they are. `decay_factor` multiplies every group's
  /// weight decay.
  void step(double learning_rate, double decay_factor = 1);
  /// Square root of the sum of the squares of all gradients.
  double gradient_norm() const;
  /// Scales the gradients down so that their norm is at most `most`; returns what it was.
  double clip_gradients(double most);

  std::uint64_t steps() const { return steps_; }
  /// exp_avg.NAME and exp_avg_sq.NAME: what the next step needs besides the parameters and steps().
  Parameters state() const;
  /// Takes a state over. Throws SetupError (bad_data) when it is not this optimiser's.
  void restore(const Parameters& state, std::uint64_t steps);

  const std::vector<ParameterGroup>& groups() const { return groups_; }

 private:
  void update(const std::string& name, const at::Tensor& parameter, double learning_rate, double decay);

  std::vector<ParameterGroup> groups_;
  double beta1_, beta2_, epsilon_;
  std::uint64_t steps_ = 0;
  Parameters mean_, square_;
};

}  // namespace csipose::train
