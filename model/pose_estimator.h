// model/pose_estimator.h - a window in, tracked people in the room out: engine, scores, pose-NMS, room frame, tracker.
#pragma once

#include <memory>
#include <string>
#include <vector>

#include "model/engine.h"
#include "proto/pose.h"
#include "proto/window.h"

namespace csipose {

enum class Smoothing : std::uint8_t { none, one_euro };

struct EstimatorConfig {
  int max_people = 5;            ///< at most kMaxPeople
  float min_score = 0.4f;        ///< on the calibrated score: the track's, or the window's without tracking
  float nms_distance_m = 0.25f;  ///< mean joint distance under which the lower-scored of two poses is dropped
  bool track = true;
  Nanoseconds track_timeout = std::chrono::milliseconds(1000);
  Nanoseconds score_memory =
      std::chrono::milliseconds(300);  ///< that a track's score is the mean of; 0: the window's
  Smoothing smoothing = Smoothing::none;
};

/// What the estimator has to say of one window.
struct Estimate {
  std::uint32_t people_count = 0;
  std::array<Person, kMaxPeople> people{};
  Reasons reasons = 0;  ///< too_few_links, nan_input, unknown_installation: then people_count is 0
};

/// Of windows' unlikeness to the likeliest background, averaged over about ten seconds (model/installation_finder.h): above it the
/// installation is none that the weights know. Measured on simulated windows: means over seven seconds of unseen clips in known
/// installations reached 3.0, those over a third of a second after another powering up of the cards began at 3.4 (docs/training.md).
inline constexpr double kMostUnlike = 3.2;

class PoseEstimator {
 public:
  PoseEstimator(std::shared_ptr<const Model> model, std::unique_ptr<Engine> engine,
                const EstimatorConfig& config);
  ~PoseEstimator();
  /// Runs the network on the window's present links, against the background of the installation that the last seconds came from. Fewer links than the model allows, numbers that are not finite, or
  /// an installation that the model does not know, give no people and the reason. Tracks age by `window.last_sample`.
  const Estimate& estimate(const Window& window);
  /// Takes new values of min_score, track, track_timeout, score_memory, smoothing between two windows (configuration reload).
  void configure(const EstimatorConfig& config);
  /// Forgets all tracks and the installation (data stopped: nobody is followed across the silence); ids are still never reused.
  void reset();
  const Model& model() const;
  const Engine& engine() const;

 private:
  struct State;
  std::unique_ptr<State> state_;
};

}  // namespace csipose
