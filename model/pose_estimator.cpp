#include "model/pose_estimator.h"

#include <fmt/format.h>

#include <algorithm>
#include <cassert>
#include <cmath>

#include "model/installation_finder.h"
#include "model/model.h"
#include "model/postprocess.h"
#include "model/tracker.h"
#include "proto/result.h"

namespace csipose {
namespace {

constexpr float kFollowed = 0.1f;  // whoever scores less in a window adds nothing to a track

void check(const EstimatorConfig& config) {
  const auto refuse = [](const std::string& words) { throw SetupError(ExitStatus::bad_config, words); };
  if (config.max_people < 1 || config.max_people > static_cast<int>(kMaxPeople))
    refuse(fmt::format("at most {} people are wanted in a frame; it carries 1 to {}", config.max_people,
                       kMaxPeople));
  if (!(config.min_score >= 0 && config.min_score <= 1))
    refuse(fmt::format("min_score is {}; it is a probability from 0 to 1", config.min_score));
  if (!config.track && config.smoothing != Smoothing::none)
    refuse(
        "smoothing is asked for while tracking is off; switch tracking on, for only a tracked person has a "
        "past");
}

/// Are the numbers of the links that will be encoded all finite?
bool is_finite(const Window& window) {
  for (std::size_t c = 0; c < kChannels; ++c)
    for (std::size_t t = 0; t < kSamples; ++t)
      for (std::size_t l = 0; l < kLinks; ++l)
        if (window.links[l] && !std::isfinite(window.x[Window::index(c, t, l)])) return false;
  return true;
}

}  // namespace

struct PoseEstimator::State {
  State(std::shared_ptr<const Model> of, std::unique_ptr<Engine> by)
      : model(std::move(of)), engine(std::move(by)), installation(model->normalisation().backgrounds) {}

  std::shared_ptr<const Model> model;
  std::unique_ptr<Engine> engine;
  EstimatorConfig config;
  Tracker tracker;
  Estimate estimate;
  InstallationFinder installation;

  const Estimate& nobody(Reason reason) {
    estimate.people_count = 0;
    estimate.reasons = reason_bit(reason);
    return estimate;
  }
};

PoseEstimator::PoseEstimator(std::shared_ptr<const Model> model, std::unique_ptr<Engine> engine,
                             const EstimatorConfig& config)
    : state_(std::make_unique<State>(std::move(model), std::move(engine))) {
  configure(config);
}
PoseEstimator::~PoseEstimator() = default;

void PoseEstimator::configure(const EstimatorConfig& config) {
  check(config);
  if (state_->config.track && !config.track) state_->tracker.reset();
  state_->config = config;
  state_->tracker.configure({config.track_timeout, config.smoothing == Smoothing::one_euro,
                             config.score_memory, config.min_score,
                             static_cast<std::size_t>(config.max_people)});
}

const Estimate& PoseEstimator::estimate(const Window& window) {
  State& s = *state_;
  if (window.links.count() < s.model->demand().min_links) return s.nobody(Reason::too_few_links);
  if (!is_finite(window)) return s.nobody(Reason::nan_input);
  const NearestBackground here = s.installation.add(window.x, window.links, window.last_sample);
  if (here.unlikeness > kMostUnlike) return s.nobody(Reason::unknown_installation);
  const NetworkOutput output = s.engine->run(window.x, window.links, here.background);
  const Selection selection =
      s.config.track ? Selection{kMaxPeople, std::min(kFollowed, s.config.min_score), s.config.nms_distance_m}
                     : Selection{static_cast<std::size_t>(s.config.max_people), s.config.min_score,
                                 s.config.nms_distance_m};
  const Selected selected = select_people(output, *s.model, selection, s.estimate.people);
  if (selected.not_finite) return s.nobody(Reason::nan_input);
  s.estimate.people_count = static_cast<std::uint32_t>(selected.count);
  s.estimate.reasons = 0;
  if (s.config.track)
    s.estimate.people_count = static_cast<std::uint32_t>(
        s.tracker.update(window.last_sample, std::span(s.estimate.people).first(selected.count)));
  return s.estimate;
}

void PoseEstimator::reset() {
  state_->tracker.reset();
  state_->installation.reset();
}
const Model& PoseEstimator::model() const { return *state_->model; }
const Engine& PoseEstimator::engine() const { return *state_->engine; }

}  // namespace csipose
