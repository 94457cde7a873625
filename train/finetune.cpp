#include "train/finetune.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <nlohmann/json.hpp>
#include <numeric>

#include "model/metrics.h"
#include "model/seeded_random.h"
#include "proto/result.h"
#include "proto/window.h"
#include "train/initial_weights.h"
#include "train/losses.h"
#include "train/schedules.h"

namespace csipose::train {
namespace {

namespace fs = std::filesystem;

constexpr double kPaperLr = 2e-5, kReducedLr = 3e-4;
constexpr double kPaperEncoderLr = 0.1, kReducedEncoderLr = 0.3;
constexpr double kSigmaLr = 1e-3;      // of the head for the expected error: one row of numbers
constexpr double kStepAt = 0.8;        // of the steps; then a tenth of the rate
constexpr double kCosineFloor = 0.01;  // of the rate
constexpr std::size_t kEvaluationBatch = 64, kLearntWindows = 1024;

/// The recipe with what "by preset" stands for filled in.
struct Recipe {
  explicit Recipe(const RunSettings& settings) {
    const bool paper = settings.network.preset == "paper";
    const auto& s = settings.finetune;
    lr = s.lr > 0 ? s.lr : paper ? kPaperLr : kReducedLr;
    encoder_factor = s.encoder_lr > 0 ? s.encoder_lr : paper ? kPaperEncoderLr : kReducedEncoderLr;
    cosine = s.schedule == "cosine" || (s.schedule == "auto" && !paper);
    warm_up = s.warm_up;
  }
  double rate(std::uint64_t step, std::uint64_t total) const {
    const double warmed = warm_up_factor(warm_up, step, total);
    if (cosine) return warmed * half_cosine(lr, kCosineFloor * lr, step, total);
    return warmed * (static_cast<double>(step) > kStepAt * static_cast<double>(total) ? 0.1 * lr : lr);
  }
  double lr, encoder_factor, warm_up;
  bool cosine;
};

bool is_learned(const std::string& name, const RunSettings& settings) {
  if (settings.finetune.freeze_encoder && name.rfind("encoder.", 0) == 0) return false;
  if (name.rfind("predictor.ordered.", 0) == 0 || name.rfind("predictor.map.", 0) == 0) return true;
  if (settings.finetune.encoder_only && name.rfind("encoder.", 0) != 0) return false;
  for (const char* not_learned : {"norm.", "calib.", "predictor.", "target_encoder.", "sigma_branch."})
    if (name.rfind(not_learned, 0) == 0) return false;
  return true;
}

std::vector<ParameterGroup> groups_of(const Parameters& parameters, const RunSettings& settings) {
  const double decay = settings.finetune.weight_decay;
  ParameterGroup encoder{{}, Recipe(settings).encoder_factor, decay}, rest{{}, 1, decay};
  for (const auto& [name, tensor] : parameters)
    if (is_learned(name, settings))
      (name.rfind("encoder.", 0) == 0 ? encoder : rest).parameters.set(name, tensor);
  return {encoder, rest, {parameters.under("sigma_branch."), 1, decay}};
}

// ---- evaluation ----

/// Poses [queries][14][3] as skeletons.
std::vector<Skeleton> skeletons_of(const float* poses, std::int64_t queries) {
  std::vector<Skeleton> all(static_cast<std::size_t>(queries));
  for (Skeleton& skeleton : all)
    for (Point3& joint : skeleton) joint = {poses[0], poses[1], poses[2]}, poses += 3;
  return all;
}

// ---- what fails in a batch ----

/// `count` different numbers below `of`.
std::vector<std::size_t> choose(std::size_t count, std::size_t of, SeededRandom& random) {
  std::vector<std::size_t> all(of);
  std::iota(all.begin(), all.end(), std::size_t{0});
  for (std::size_t i = 0; i < count; ++i) std::swap(all[i], all[i + random.index(of - i)]);
  all.resize(count);
  return all;
}

/// One of each of `count` equal parts of the numbers below `of`, ascending.
std::vector<std::size_t> choose_spread(std::size_t count, std::size_t of, SeededRandom& random) {
  std::vector<std::size_t> one_each;
  for (std::size_t i = 0; i < count; ++i) {
    const std::size_t from = i * of / count, to = (i + 1) * of / count;
    one_each.push_back(from + random.index(to - from));
  }
  return one_each;
}

/// Of a network's tokens those of these samples and links, ascending as the samples are.
TokenList tokens_of(const NetworkConfig& config, const std::vector<std::size_t>& samples,
                    const LinkSet& links) {
  const std::size_t columns = config.token_grid().columns;
  TokenList tokens;
  for (const std::size_t t : samples)
    for (std::size_t column = 0; column < columns; ++column)
      if (config.has_token(column, links)) tokens.push_back(static_cast<std::int64_t>(t * columns + column));
  return tokens;
}

/// Of the run's steps those that teach poses; the head for the expected error learns in the rest.
std::uint64_t pose_steps(const RunSettings& settings, const Moment& now) {
  const auto pose = static_cast<std::uint64_t>(settings.finetune.epochs);
  const auto sigma =
      static_cast<std::uint64_t>(network_of_poses(settings).joint_sigma ? settings.finetune.sigma_epochs : 0);
  return now.total / (pose + sigma) * pose;
}

/// How many of a window's samples are encoded in this step.
std::size_t samples_of_step(const RunSettings& settings, const Moment& now) {
  const auto all_from = settings.finetune.all_samples_from * static_cast<double>(pose_steps(settings, now));
  return static_cast<double>(now.step) > all_from ? kSamples
                                                  : static_cast<std::size_t>(settings.finetune.samples);
}

struct Failure {
  std::size_t receivers = 0, links = 0;
};
Failure draw_failure(const RunSettings& settings, SeededRandom& random) {
  const auto& s = settings.finetune;
  const double u = random.uniform();
  if (u < s.lose_receiver) return {1, 0};
  if (u < s.lose_receiver + s.lose_two_receivers) return {2, 0};
  if (u < s.lose_receiver + s.lose_two_receivers + s.lose_links) return {0, 1 + random.index(3)};
  return {};
}

/// Of one window. Receiver tokens are as many in all windows of a batch: links that fail one by one leave each receiver one.
LinkSet links_left(const Failure& failure, const NetworkConfig& config, SeededRandom& random) {
  for (;;) {
    LinkSet links = LinkSet().set();
    for (const std::size_t receiver : choose(failure.receivers, kReceivers, random))
      for (std::size_t a = 0; a < kAntennas; ++a) links.reset(receiver * kAntennas + a);
    for (const std::size_t link : choose(failure.links, kLinks, random)) links.reset(link);
    if (!config.receiver_tokens || failure.links == 0 ||
        config.token_count(links) == config.token_grid().size())
      return links;
  }
}

// ---- the objective ----

class Poses3d : public Objective {
 public:
  Poses3d(const RunSettings& settings, const Pool& pool, const Split& split, const Workers& workers,
          Weights weights, const Numerics& numerics)
      : settings_(settings),
        pool_(pool),
        split_(split),
        workers_(workers),
        weights_(std::move(weights)),
        numerics_(numerics),
        recipe_(settings),
        shape_(decoder_shape(weights_.config)),
        loss_weights_{settings.finetune.cls, settings.finetune.kpt, settings.finetune.refine,
                      settings.finetune.error == "distance" ? PoseError::distance : PoseError::squared,
                      settings.finetune.root_relative},
        optimiser_(groups_of(weights_.parameters, settings)) {
    if (settings.finetune.map > 0) grid_ = floor_of(pool, split.train);
    const auto memory = nlohmann::json::parse(weights_.metadata["progress"], nullptr, false);
    if (memory.is_object()) best_m_ = memory.value("best_m", HUGE_VAL);
  }

  AdamW& optimiser() override { return optimiser_; }
  const Weights& weights() override { return weights_; }

  at::Tensor loss(std::span<const std::uint64_t> windows, const Moment& now, Figures& figures) override {
    if (sigma_phase(now) && now.step == pose_steps(settings_, now) + 1) begin_sigma_phase();
    seed_dropout(now);
    const Added added =
        sigma_phase(now) ? Added() : added_people(settings_, pool_, split_.train, now, windows);
    at::Tensor tokens = pool_.tokens(windows, added);
    Survivors survivors = surviving_tokens(settings_, now, windows);
    if (survivors.links.defined()) silence(tokens, weights_.config, survivors.links);
    at::Tensor left = survivors.tokens;
    if (left.defined()) left = left.to(tokens.device());
    const People people = pool_.people_of(windows, added);
    const double matched = workers_.average(matched_people(people, left));
    if (sigma_phase(now)) return sigma_only(tokens, left, people, matched);
    const at::Tensor features = encoded(tokens, left);
    at::Tensor sum = encoder_loss(features, people, matched, figures);
    if (settings_.finetune.encoder_only) return sum;
    Numerics numerics = numerics_;
    numerics.dropout = settings_.finetune.dropout;
    const Decoded decoded =
        decode(weights_.parameters, shape_, memory_of(weights_.parameters, features, numerics), numerics,
               static_cast<double>(samples_of_step(settings_, now)) / kSamples);
    const SetLoss loss =
        set_loss(weights_.parameters, shape_, decoded, people, loss_weights_, numerics, matched);
    figures.insert(figures.begin(), {{"cls", loss.cls.item<double>()},
                                     {"kpt", loss.kpt.item<double>()},
                                     {"refine", loss.refine.item<double>()}});
    return sum.defined() ? loss.total + sum : loss.total;
  }

  double make_step(const Moment& now, Figures& figures) override {
    const double lr = sigma_phase(now) ? kSigmaLr : recipe_.rate(now.step, pose_steps(settings_, now));
    const double norm = settings_.finetune.clip > 0 ? optimiser_.clip_gradients(settings_.finetune.clip)
                                                    : optimiser_.gradient_norm();
    optimiser_.step(lr);
    weights_.metadata["step"] = std::to_string(now.step);
    figures.emplace_back("gradient", norm);
    return lr;
  }

  void end_epoch(const Moment& now, Figures& figures) override {
    if (sigma_phase(now)) return;
    const bool judged = !split_.held_out.empty();
    if (!judged && now.step != pose_steps(settings_, now)) return;
    if (settings_.finetune.encoder_only) return end_encoder_epoch(figures);
    const double error_m =
        judged ? oracle_error_m(weights_.parameters, weights_.config, pool_, split_.held_out, numerics_) : 0;
    if (judged) figures.emplace_back("held_out_mpjpe_mm", 1000 * error_m);
    if (!judged) {  // nothing was kept from it: how well it knows what it learnt from
      const auto some = spread(split_.train, kLearntWindows);
      figures.emplace_back("learnt_mpjpe_mm", 1000 * oracle_error_m(weights_.parameters, weights_.config,
                                                                    pool_, some, numerics_));
    }
    if (judged && error_m >= best_m_) return;
    best_m_ = error_m;
    remember(now);
    if (workers_.first()) write_weights(folder() / "best.safetensors", weights_);
  }

  void finish(const Moment& now) override {
    if (!sigma_phase(now)) write_weights(folder() / "last.safetensors", weights_);
    if (sigma_phase(now)) write_weights(folder() / "best.safetensors", weights_);
  }

 private:
  fs::path folder() const { return settings_.run.out; }

  /// What teaches the encoder without the decoder; undefined when nothing does.
  at::Tensor encoder_loss(const at::Tensor& features, const People& people, double matched,
                          Figures& figures) {
    at::Tensor sum;
    const auto add = [&](const char* name, double weight, const at::Tensor& loss) {
      figures.emplace_back(name, loss.item<double>());
      sum = sum.defined() ? sum + weight * loss : weight * loss;
    };
    if (settings_.finetune.ordered > 0)
      add("ordered", settings_.finetune.ordered,
          ordered_loss(weights_.parameters, features, people, loss_weights_, matched));
    if (settings_.finetune.map > 0)
      add("map", settings_.finetune.map, map_loss(weights_.parameters, features, people, *grid_));
    return sum;
  }

  /// There are no poses to judge: by what teaches the encoder, all samples encoded.
  void end_encoder_epoch(Figures& figures) {
    const at::NoGradGuard no_gradients;
    const auto& windows = split_.held_out.empty() ? split_.train : split_.held_out;
    const auto some = spread(windows, kLearntWindows);
    double sum = 0;
    for (std::size_t from = 0; from < some.size(); from += kEvaluationBatch) {
      const auto part = std::span(some).subspan(from, std::min(kEvaluationBatch, some.size() - from));
      const People people = pool_.people_of(part);
      Figures none;
      sum += encoder_loss(encoded(pool_.tokens(part), {}), people, matched_people(people, {}), none)
                 .item<double>() *
             static_cast<double>(part.size());
    }
    const double loss = sum / static_cast<double>(some.size());
    figures.emplace_back(split_.held_out.empty() ? "learnt_loss" : "held_out_loss", loss);
    if (!split_.held_out.empty() && loss >= best_m_) return;
    best_m_ = loss;
    weights_.metadata["progress"] = nlohmann::json{{"best_m", best_m_}}.dump();
    weights_.metadata["metrics"] = "{}";
    if (workers_.first()) write_weights(folder() / "best.safetensors", weights_);
  }

  at::Tensor encoded(const at::Tensor& tokens, const at::Tensor& left) const {
    const at::AutoGradMode learns(at::GradMode::is_enabled() && !settings_.finetune.freeze_encoder);
    return encode(weights_.parameters, "encoder.", encoder_shape(weights_.config), tokens, left, numerics_);
  }

  bool sigma_phase(const Moment& now) const { return now.step > pose_steps(settings_, now); }

  /// The poses are done; what follows learns on the best of them.
  void begin_sigma_phase() {
    if (workers_.first()) write_weights(folder() / "last.safetensors", weights_);
    workers_.any(false);  // nobody reads before the first has written
    const Weights best = read_weights(folder() / "best.safetensors");
    const at::NoGradGuard no_gradients;
    for (const auto& [name, tensor] : best.parameters) weights_.parameters[name].detach().copy_(tensor);
  }

  at::Tensor sigma_only(const at::Tensor& tokens, const at::Tensor& left, const People& people,
                        double matched) {
    Decoded decoded;
    {
      const at::NoGradGuard no_gradients;
      const at::Tensor features = encoded(tokens, left);
      decoded =
          decode(weights_.parameters, shape_, memory_of(weights_.parameters, features, numerics_), numerics_);
    }
    return sigma_loss(weights_.parameters, shape_, decoded, people, loss_weights_, numerics_, matched);
  }

  /// People who get a query: all, unless there are more of them than queries.
  double matched_people(const People& people, const at::Tensor& left) const {
    const std::int64_t tokens =
        left.defined() ? left.size(1) : static_cast<std::int64_t>(weights_.config.token_grid().size());
    const std::int64_t queries = std::min(tokens, static_cast<std::int64_t>(weights_.config.queries));
    std::int64_t sum = 0;
    for (const std::int64_t there : people.count) sum += std::min(there, queries);
    return static_cast<double>(sum);
  }

  void seed_dropout(const Moment& now) const {
    SeededRandom random(static_cast<std::uint64_t>(settings_.run.seed), "dropout",
                        {now.step, static_cast<std::uint64_t>(workers_.rank())});
    at::manual_seed(random.next());
  }

  void remember(const Moment& now) {
    weights_.metadata["progress"] = nlohmann::json{{"best_m", best_m_}}.dump();
    weights_.metadata["metrics"] = split_.held_out.empty()
                                       ? "{}"
                                       : nlohmann::json{{"protocol", "piw3d"},
                                                        {"on", "held-out clips"},
                                                        {"epoch", now.epoch + 1},
                                                        {"n_frames", split_.held_out.size()},
                                                        {"mpjpe", 1000 * best_m_}}
                                             .dump();
  }

  const RunSettings& settings_;
  const Pool& pool_;
  const Split& split_;
  const Workers& workers_;
  Weights weights_;
  Numerics numerics_;
  Recipe recipe_;
  DecoderShape shape_;
  SetLossWeights loss_weights_;
  AdamW optimiser_;
  double best_m_ = HUGE_VAL;
  std::optional<FloorGrid> grid_;
};

// ---- before the first step ----

/// A flat token may be of two links, and is of several samples: none can be left out.
void require_whole_windows(const RunSettings& settings) {
  const auto& s = settings.finetune;
  if (settings.network.flat_tokens &&
      (s.samples < static_cast<int>(kSamples) || s.lose_receiver + s.lose_two_receivers + s.lose_links > 0))
    throw SetupError(ExitStatus::bad_config,
                     "network.flat_tokens needs whole windows: finetune.samples = 20, and lose_receiver, "
                     "lose_two_receivers and lose_links = 0");
}

/// A window that holds few samples for long is as good as a whole one only where no step takes more of them.
void require_samples(const RunSettings& settings, const Pool& pool) {
  if (settings.finetune.all_samples_from < 1)
    pool.require_samples(kSamples, "finetune.all_samples_from below 1");
  if (settings.finetune.sigma_epochs > 0) pool.require_samples(kSamples, "finetune.sigma_epochs");
  pool.require_samples(static_cast<std::size_t>(settings.finetune.samples), "finetune.samples");
}

void scale(Pool& pool, const Split& split, const RunSettings& settings) {
  if (settings.data.norm == "none") return;
  if (settings.data.norm != "init") return pool.measure_scaling(split.train, scaled_by(settings.data.norm));
  if (settings.finetune.init.empty())
    throw SetupError(ExitStatus::bad_config,
                     "data.norm = \"init\" takes the scaling of finetune.init, which names no file");
  pool.set_scaling(Model::load(settings.finetune.init)->normalisation());
}

}  // namespace

double oracle_error_m(const Parameters& weights, const NetworkConfig& config, const Pool& pool,
                      std::span<const std::uint64_t> windows, const Numerics& numerics) {
  Metrics metrics(Protocol::piw3d);
  for (std::size_t from = 0; from < windows.size(); from += kEvaluationBatch) {
    const auto part = windows.subspan(from, std::min(kEvaluationBatch, windows.size() - from));
    const at::Tensor joints =
        infer(weights, config, pool.tokens(part), {}, numerics).joints.to(at::kCPU, at::kFloat).contiguous();
    for (std::size_t b = 0; b < part.size(); ++b)
      metrics.add(skeletons_of(joints.data_ptr<float>() + static_cast<std::int64_t>(b) * joints.stride(0),
                               joints.size(1)),
                  pool.people(part[b]));
  }
  return metrics.all().frame_mean.mpjpe / 1000;
}

Added added_people(const RunSettings& settings, const Pool& pool, std::span<const std::uint64_t> from,
                   const Moment& now, std::span<const std::uint64_t> windows) {
  if (settings.finetune.overlay == 0) return {};
  constexpr int kTries = 60;  // other installations are drawn as well, and more people than may be added
  const auto most = static_cast<std::size_t>(settings.finetune.overlay_people);
  Added added(windows.size());
  for (std::size_t b = 0; b < windows.size(); ++b) {
    SeededRandom random(static_cast<std::uint64_t>(settings.run.seed), "overlay", {now.epoch, windows[b]});
    const std::string installation = pool.installation(windows[b]);
    std::size_t people = pool.people(windows[b]).size();
    for (int tries = 0; tries < kTries && people < most && random.uniform() < settings.finetune.overlay;) {
      std::uint64_t other = 0;
      std::size_t more = 0;
      do {
        other = from[random.index(from.size())];
        more = pool.people(other).size();
      } while (++tries < kTries &&
               (more == 0 || people + more > most || pool.installation(other) != installation));
      if (tries == kTries) break;
      added[b].push_back(other);
      people += more;
    }
  }
  return added;
}

Survivors surviving_tokens(const RunSettings& settings, const Moment& now,
                           std::span<const std::uint64_t> windows) {
  const auto seed = static_cast<std::uint64_t>(settings.run.seed);
  const NetworkConfig config = network_of(settings);
  SeededRandom batch(seed, "failures of a batch", {now.epoch, windows.front()});
  const Failure failure = draw_failure(settings, batch);
  const std::size_t samples = samples_of_step(settings, now);
  if (failure.receivers == 0 && failure.links == 0 && samples == kSamples) return {};
  std::vector<std::int64_t> tokens;
  std::vector<float> there;
  for (const std::uint64_t window : windows) {
    SeededRandom random(seed, "failures of a window", {now.epoch, window});
    const LinkSet links = links_left(failure, config, random);
    const TokenList left = tokens_of(config, choose_spread(samples, kSamples, random), links);
    tokens.insert(tokens.end(), left.begin(), left.end());
    for (std::size_t l = 0; l < kLinks; ++l) there.push_back(links[l] ? 1.f : 0.f);
  }
  const auto count = static_cast<std::int64_t>(windows.size());
  Survivors survivors{at::tensor(tokens, at::kLong).view({count, -1}), {}};
  if (config.token_links() > 1 && failure.links > 0)
    survivors.links = at::tensor(there).view({count, kLinks});
  return survivors;
}

void silence(at::Tensor& tokens, const NetworkConfig& config, const at::Tensor& links) {
  const std::vector<std::int64_t> in_turn = config.token_links_in_turn();
  const auto parts = static_cast<std::int64_t>(in_turn.size());
  const std::int64_t windows = tokens.size(0);
  tokens.view({windows, kSamples, parts, -1})
      .mul_(links.index_select(1, at::tensor(in_turn)).to(tokens.device()).view({windows, 1, parts, 1}));
}

Outcome finetune(const RunSettings& settings, Pool& pool, const Workers& workers) {
  require_whole_windows(settings);
  require_samples(settings, pool);
  CheckpointFolder folder(settings.run.out);
  if (workers.first()) folder.claim();
  std::optional<Checkpoint> resumed = checkpoint_to_resume(folder, settings);
  Split split = split_by_clip(pool, settings.data.hold_out, static_cast<std::uint64_t>(settings.run.seed));
  if (settings.data.most_people > 0) {
    for (auto* part : {&split.train, &split.held_out})
      std::erase_if(*part, [&](std::uint64_t window) {
        return pool.people(window).size() > static_cast<std::size_t>(settings.data.most_people);
      });
    if (split.train.empty())
      throw SetupError(
          ExitStatus::bad_config,
          fmt::format("data.most_people = {}: no window of the data has so few", settings.data.most_people));
  }
  split.train = spread(split.train, static_cast<std::size_t>(settings.data.take));
  LoopPlan plan{split.train, static_cast<std::uint64_t>(settings.finetune.epochs),
                static_cast<std::uint64_t>(settings.finetune.batch)};
  if (network_of_poses(settings).joint_sigma)
    plan.epochs += static_cast<std::uint64_t>(settings.finetune.sigma_epochs);
  scale(pool, split, settings);
  if (settings.finetune.overlay > 0 && pool.scaling().front().backgrounds.empty())
    throw SetupError(
        ExitStatus::bad_config,
        "finetune.overlay adds departures from a background, and none is known; set data.norm to "
        "\"background\", or to \"init\" with a file that has them");
  pool.give_for(network_of_poses(settings));
  const at::Device device = device_of(settings, workers);
  const Numerics numerics = choose_numerics(settings, resumed, device);
  Weights weights =
      resumed ? std::move(resumed->weights) : initial_weights(settings, pool, split.train, numerics);
  weights.parameters.move_to(device);
  pool.give_on(device);
  Poses3d poses(settings, pool, split, workers, std::move(weights), numerics);
  if (resumed) poses.optimiser().restore(resumed->optimiser, resumed->step);
  return run_loop(poses, plan, settings, workers, folder, resumed ? resumed->step : 0);
}

}  // namespace csipose::train
