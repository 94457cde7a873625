#include "train/pretrain.h"

#include <fmt/format.h>

#include <cmath>
#include <nlohmann/json.hpp>

#include "proto/result.h"
#include "train/losses.h"
#include "train/masks.h"
#include "train/schedules.h"
#include "version.h"

namespace csipose::train {
namespace {

constexpr double kCollapsed = 0.05;  // of the first epoch's deviation: then the target says nothing any more
constexpr std::int64_t kRankSample = 4096;  // features that the effective rank is measured on
constexpr double kPaperLr = 5e-4, kReducedLr = 1e-3;

at::Tensor index_tensor(const std::vector<TokenList>& lists) {
  std::vector<std::int64_t> flat;
  for (const TokenList& list : lists) flat.insert(flat.end(), list.begin(), list.end());
  return at::tensor(flat, at::kLong).view({static_cast<std::int64_t>(lists.size()), -1});
}

/// Matrices decay, everything else does not.
std::vector<ParameterGroup> groups_of(const Parameters& parameters, double weight_decay) {
  ParameterGroup matrices{{}, 1, weight_decay}, others{{}, 1, 0};
  for (const char* part : {"encoder.", "predictor."})
    for (const auto& [name, tensor] : parameters.under(part)) {
      const bool matrix = tensor.dim() >= 2 && name != "predictor.mask_token";
      (matrix ? matrices : others).parameters.set(name, tensor);
    }
  return {matrices, others};
}

class Jepa : public Objective {
 public:
  Jepa(const RunSettings& settings, const Pool& pool, Weights weights, const Numerics& numerics)
      : settings_(settings),
        pool_(pool),
        weights_(std::move(weights)),
        numerics_(numerics),
        masking_(masking_named(settings.pretrain.mask)),
        predictor_(predictor_shape(settings.network.preset)),
        optimiser_(groups_of(weights_.parameters, settings.pretrain.weight_decay)) {
    predictor_.grid = weights_.config.token_grid();
    const auto memory = nlohmann::json::parse(weights_.metadata["progress"], nullptr, false);
    if (memory.is_object()) first_deviation_ = memory.value("first_deviation", 0.);
  }

  AdamW& optimiser() override { return optimiser_; }
  const Weights& weights() override { return weights_; }

  at::Tensor loss(std::span<const std::uint64_t> windows, const Moment& now, Figures&) override {
    const BatchMasks masks = masks_for(windows, now.epoch);
    const at::Tensor tokens = pool_.tokens(windows),
                     context = index_tensor(masks.context).to(tokens.device());
    const EncoderShape shape = encoder_shape(weights_.config);
    {
      const at::NoGradGuard no_gradients;
      features_ = encode(weights_.parameters, "target_encoder.", shape, tokens, {}, numerics_);
    }
    const at::Tensor z = encode(weights_.parameters, "encoder.", shape, tokens, context, numerics_);
    at::Tensor sum = at::zeros({});
    for (const std::vector<TokenList>& block : masks.targets) {
      const at::Tensor hidden = index_tensor(block).to(tokens.device());
      sum = sum + prediction_loss(predict(weights_.parameters, predictor_, z, context, hidden, numerics_),
                                  normalised_target(features_, hidden));
    }
    return sum / static_cast<double>(masks.targets.size());
  }

  double make_step(const Moment& now, Figures& figures) override {
    const auto& s = settings_.pretrain;
    const auto warm_up = static_cast<std::uint64_t>(std::lround(s.warm_up * static_cast<double>(now.total)));
    const double lr = WarmUpCosine{s.lr_start, peak_lr(), s.lr_final}.at(now.step, warm_up, now.total);
    const double decay =
        s.weight_decay_final > 0 && s.weight_decay > 0
            ? half_cosine(s.weight_decay, s.weight_decay_final, now.step, now.total) / s.weight_decay
            : 1;
    optimiser_.step(lr, decay);
    const double momentum = s.ema == "cosine" ? momentum_cosine(s.ema_start, now.step, now.total)
                                              : momentum_linear(s.ema_start, now.step, now.total);
    follow(weights_.parameters, "target_encoder.", weights_.parameters, "encoder.", momentum);
    weights_.metadata["step"] = std::to_string(now.step);
    figures.emplace_back("momentum", momentum);
    return lr;
  }

  void end_epoch(const Moment& now, Figures& figures) override {
    const at::NoGradGuard no_gradients;
    const at::Tensor flat = features_.flatten(0, 1);
    const double deviation = flat.std(0).mean().item<double>();
    const std::int64_t apart = std::max<std::int64_t>(1, flat.size(0) / kRankSample);
    const at::Tensor sample = flat.slice(0, 0, apart * kRankSample, apart);
    if (now.epoch == 0) first_deviation_ = deviation;
    figures = {{"target_std", deviation}, {"effective_rank", effective_rank(sample)}};
    if (deviation < kCollapsed * first_deviation_) figures.emplace_back("COLLAPSED", 1);
    weights_.metadata["progress"] = nlohmann::json{{"first_deviation", first_deviation_}}.dump();
  }

  void finish(const Moment&) override {
    write_weights(std::filesystem::path(settings_.run.out) / "pretrained.safetensors", weights_);
  }

 private:
  BatchMasks masks_for(std::span<const std::uint64_t> windows, std::uint64_t epoch) const {
    const auto seed = static_cast<std::uint64_t>(settings_.run.seed);
    if (weights_.config.flat_tokens) return draw_flat_masks(seed, epoch, windows);
    if (weights_.config.receiver_tokens) return draw_receiver_masks(masking_, seed, epoch, windows);
    if (weights_.config.receiver_conditioning && masking_ != Masking::time)
      throw SetupError(
          ExitStatus::bad_config,
          "network.receiver_conditioning goes with pretrain.mask = \"time\" only: a token also has links "
          "that another mask would hide");
    return draw_masks(masking_, seed, epoch, windows);
  }

  double peak_lr() const {
    if (settings_.pretrain.lr > 0) return settings_.pretrain.lr;
    return settings_.network.preset == "paper" ? kPaperLr : kReducedLr;
  }

  const RunSettings& settings_;
  const Pool& pool_;
  Weights weights_;
  Numerics numerics_;
  Masking masking_;
  PredictorShape predictor_;
  AdamW optimiser_;
  at::Tensor features_;  // the target's, of the last batch
  double first_deviation_ = 0;
};

Weights initial_weights(const RunSettings& settings, const Pool& pool, const Numerics& numerics) {
  const NetworkConfig config = network_of(settings);
  const auto seed = static_cast<std::uint64_t>(settings.run.seed);
  Weights weights = untrained_weights(config, seed);
  weights.parameters.merge(initial_predictor(predictor_shape(settings.network.preset), config.dim, seed));
  if (settings.network.init == "fan_in")
    for (const char* part : {"encoder.", "predictor."}) scale_to_fan_in(weights.parameters, part);
  weights.parameters.merge(weights.parameters.renamed_copy("encoder.", "target_encoder."));
  set_normalisation(weights, pool.scaling().front());
  weights.metadata["stage"] = "pretrained";
  weights.metadata["git"] = CSIPOSE_COMMIT;
  weights.metadata["corpus"] = pool.describe();
  weights.metadata["run"] = to_toml(settings, false);
  weights.metadata["numerics"] = numerics.matmul == at::kBFloat16 ? "bf16" : "f32";
  weights.metadata["progress"] = "{}";
  return weights;
}

}  // namespace

double effective_rank(const at::Tensor& features) {
  const at::Tensor centred = (features - features.mean(0, true)).to(at::kDouble);
  const at::Tensor values = at::linalg_svdvals(centred.t().mm(centred)).clamp_min(0).sqrt();
  const at::Tensor share = values / values.sum().clamp_min(1e-300);
  return std::exp(-(share * share.clamp_min(1e-300).log()).sum().item<double>());
}

Outcome pretrain(const RunSettings& settings, Pool& pool, const Workers& workers) {
  pool.require_samples(kSamples, "pre-training");
  if (settings.data.norm == "init")
    throw SetupError(ExitStatus::bad_config,
                     "data.norm = \"init\" is for fine-tuning: pre-training begins from nothing");
  if (settings.network.flat_tokens && settings.pretrain.mask != "link")
    throw SetupError(ExitStatus::bad_config,
                     fmt::format("network.flat_tokens goes with pretrain.mask = \"link\" alone, not \"{}\"",
                                 settings.pretrain.mask));
  CheckpointFolder folder(settings.run.out);
  if (workers.first()) folder.claim();
  std::optional<Checkpoint> resumed = checkpoint_to_resume(folder, settings);
  LoopPlan plan;
  for (std::uint64_t i = 0; i < pool.size(); ++i) plan.windows.push_back(i);
  plan.windows = spread(plan.windows, static_cast<std::size_t>(settings.data.take));
  plan.epochs = static_cast<std::uint64_t>(settings.pretrain.epochs);
  plan.batch = static_cast<std::uint64_t>(settings.pretrain.batch);
  if (settings.data.norm != "none") pool.measure_scaling(plan.windows, scaled_by(settings.data.norm));
  pool.give_for(network_of(settings));
  const at::Device device = device_of(settings, workers);
  const Numerics numerics = choose_numerics(settings, resumed, device);
  Weights weights = resumed ? std::move(resumed->weights) : initial_weights(settings, pool, numerics);
  weights.parameters.move_to(device);
  pool.give_on(device);
  Jepa jepa(settings, pool, std::move(weights), numerics);
  if (resumed) jepa.optimiser().restore(resumed->optimiser, resumed->step);
  return run_loop(jepa, plan, settings, workers, folder, resumed ? resumed->step : 0);
}

}  // namespace csipose::train
