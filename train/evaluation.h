// train/evaluation.h - a model's answers to labelled windows by the daemon's engine, beside what no model at all
// would reach.
//
//   piw3d    all queries of the network (model/metrics.h)
//   detect   those that model/postprocess.h gives: raw score at least 0.30, pose-NMS 0.25 m, at most 10
//
// Everything is compared in the room frame, where the daemon's answers are: turning or mirroring both sides
// keeps every distance. The trivial answers know how many people there are, and some where. Whatever stands beside them, they are
// judged by optimal assignment without a limit: within a half metre, a guess that is nearly always far off would be judged by
// the few people who happen to be near it.
//   mean_pose       mean pose of the training set, where it was on average
//   mean_at_room    mean pose about its root, placed at the mean root of the training people of that room
//   mean_at_root    mean pose about its root, placed at each person's true root
//   mean_facing     the same of poses that were turned to face one way, turned as each person truly faces
//   last_pose       the labels of the window before in the same clip; nobody in a clip's first window
//   last_seen       the labels of the same clip's last window in the training set, where that has windows of clips that are
//                   judged by, as the published split has; nobody in other clips. Otherwise there is no such row
#pragma once

#include <filesystem>
#include <functional>
#include <memory>
#include <string>
#include <vector>

#include "model/engine.h"
#include "model/metrics.h"
#include "model/model.h"
#include "model/normalisation.h"
#include "model/postprocess.h"
#include "train/reliability.h"
#include "train/window_source.h"

namespace csipose::train {

/// Windows with their rooms: room.npy beside the windows, or one room for all.
struct EvaluationSet {
  std::shared_ptr<const WindowSource> windows;
  std::vector<std::uint8_t> rooms;
};
/// Throws SetupError as open_window_folder() does, and where no window has a label.
EvaluationSet open_evaluation_set(const std::filesystem::path& folder);
/// Several as one, one after another: clips of different folders are different clips, and so are rooms, which count on from
/// folder to folder. At least one.
EvaluationSet open_evaluation_sets(const std::vector<std::string>& folders);

/// Somebody whom `detect` gives, or would give with a lower threshold.
struct Detection {
  Person person;                         ///< as the daemon would say it
  float logit = 0;                       ///< before calibration
  std::array<float, kJoints> sigma_m{};  ///< the head's, before calibration; NaN without that head
  std::size_t match = kMissed;           ///< who it is among the labelled people
  std::array<float, kJoints> error_m{};  ///< of each joint; NaN without a match
};

/// The model's answer to one window beside who was there; room frame.
struct Answer {
  std::size_t window = 0;
  NearestBackground installation;    ///< as the daemon has found it by then
  std::vector<Skeleton> people;      ///< labelled
  std::vector<Skeleton> hypotheses;  ///< every query's pose
  std::vector<Detection> found;      ///< whom `detect` gives and how it matches them, best first
  /// Below the threshold, after the same pose-NMS, best first; with those found at most kMaxPeople. Matched as in `detect`
  /// to the people whom those found have left.
  std::vector<Detection> faint;
};
/// Asks about every window with only `links` encoded, against the installation that its clip's windows up to it come from, as the
/// daemon does. Throws SetupError where the answer is not finite.
void ask_model(Engine& engine, const Model& model, const EvaluationSet& set, LinkSet links,
               const std::function<void(const Answer&)>& tell);

/// What became of the windows' installations, of a model that knows some.
struct Installations {
  std::size_t windows = 0;
  std::size_t unknown = 0;  ///< so unlike (kMostUnlike) that the daemon would have inferred nobody
  std::size_t named = 0, mistaken = 0;  ///< with a name that the model knows, and taken for another's
  double unlikeness_sum = 0, greatest_unlikeness = 0;

  void add(const NearestBackground& found, const Model& model, const std::string& name);
};

struct Evaluation {
  Metrics piw3d{Protocol::piw3d}, detect{Protocol::detect};
  Installations installations;
  /// Of `detect`: the score, against being matched, and the confidence of each joint of those matched, against an error
  /// under kConfidentError_m. Empty where nothing was stated.
  Reliability score, joints;
};
/// `watch` is told every answer.
Evaluation evaluate_model(Engine& engine, const Model& model, const EvaluationSet& set, LinkSet links,
                          const std::function<void(const Answer&)>& watch = {});

struct TrivialFigures {
  std::string name;
  Metrics assigned{Protocol::assigned};
  Metrics detect{Protocol::detect};  ///< of those within its half metre, all the same
};
/// The five or six trivial answers to `set`, with means from `training`.
std::vector<TrivialFigures> evaluate_trivial(const EvaluationSet& training, const EvaluationSet& set,
                                             const RoomTransform& model_to_room);

}  // namespace csipose::train
