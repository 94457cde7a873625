#include "train/adamw.h"

#include <fmt/format.h>

#include <cmath>

#include "proto/result.h"

namespace csipose::train {

AdamW::AdamW(std::vector<ParameterGroup> groups, double beta1, double beta2, double epsilon)
    : groups_(std::move(groups)), beta1_(beta1), beta2_(beta2), epsilon_(epsilon) {
  for (const ParameterGroup& group : groups_)
    for (const auto& [name, parameter] : group.parameters) {
      parameter.set_requires_grad(true);
      mean_.set(name, at::zeros_like(parameter.detach()));
      square_.set(name, at::zeros_like(parameter.detach()));
    }
}

void AdamW::clear_gradients() {
  for (const ParameterGroup& group : groups_)
    for (const auto& [name, parameter] : group.parameters) parameter.mutable_grad() = at::Tensor();
}

void AdamW::step(double learning_rate, double decay_factor) {
  const at::NoGradGuard no_gradients;
  ++steps_;
  for (const ParameterGroup& group : groups_)
    for (const auto& [name, parameter] : group.parameters)
      if (parameter.grad().defined())
        update(name, parameter, learning_rate * group.lr_factor, group.weight_decay * decay_factor);
}

void AdamW::update(const std::string& name, const at::Tensor& parameter, double learning_rate, double decay) {
  const at::Tensor &gradient = parameter.grad(), &mean = mean_[name], &square = square_[name];
  const double mean_bias = 1 - std::pow(beta1_, static_cast<double>(steps_));
  const double square_bias = 1 - std::pow(beta2_, static_cast<double>(steps_));
  if (decay != 0) parameter.mul_(1 - learning_rate * decay);
  mean.lerp_(gradient, 1 - beta1_);
  square.mul_(beta2_).addcmul_(gradient, gradient, 1 - beta2_);
  const at::Tensor spread = square.sqrt().mul_(1 / std::sqrt(square_bias)).add_(epsilon_);
  parameter.addcdiv_(mean, spread, -learning_rate / mean_bias);
}

double AdamW::gradient_norm() const {
  double sum = 0;
  for (const ParameterGroup& group : groups_)
    for (const auto& [name, parameter] : group.parameters)
      if (parameter.grad().defined()) sum += std::pow(parameter.grad().norm().item<double>(), 2);
  return std::sqrt(sum);
}

double AdamW::clip_gradients(double most) {
  const double norm = gradient_norm();
  if (norm > most)
    for (const ParameterGroup& group : groups_)
      for (const auto& [name, parameter] : group.parameters)
        if (parameter.grad().defined()) parameter.mutable_grad().mul_(most / (norm + 1e-6));
  return norm;
}

Parameters AdamW::state() const {
  Parameters state = mean_.renamed_copy("", "exp_avg.");
  state.merge(square_.renamed_copy("", "exp_avg_sq."));
  return state;
}

void AdamW::restore(const Parameters& state, std::uint64_t steps) {
  const at::NoGradGuard no_gradients;
  for (const auto& [kind, moments] : {std::pair("exp_avg.", &mean_), std::pair("exp_avg_sq.", &square_)})
    for (const auto& [name, tensor] : *moments) {
      const std::string key = kind + name;
      if (!state.has(key) || state[key].sizes() != tensor.sizes())
        throw SetupError(ExitStatus::bad_data,
                         fmt::format("the optimiser's state has no '{}' of this network's shape; "
                                     "it belongs to another run",
                                     key));
      tensor.copy_(state[key]);
    }
  steps_ = steps;
}

}  // namespace csipose::train
