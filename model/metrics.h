// model/metrics.h - how far predicted people are from labelled ones: the figures by which methods are compared.
//
// Three ways to say which prediction belongs to which person:
//   piw3d     Person-in-WiFi 3D's: all predictions, no threshold; the nearest pair first, each once; a person
//             left over is scored against the last prediction. False positives cost nothing: an oracle over
//             all hypotheses.
//   detect    what a user sees: optimal assignment of those predictions that passed threshold and pose-NMS;
//             pairs further apart than 0.5 m do not count.
//   assigned  of fixed answers, as many as there are people: optimal assignment, however far.
// Errors are in the coordinates of the label, millimetres. Means go over the people of a frame, then over
// frames; frames in which nobody is matched are not in the mean, but are counted.
// Source: aiotgroup/Person-in-WiFi-3D-repo (calc_mpjpe).
#pragma once

#include <array>
#include <cstddef>
#include <map>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include "model/pose_errors.h"

namespace csipose {

enum class Protocol { piw3d, detect, assigned };
std::string_view name_of(Protocol protocol);

inline constexpr std::size_t kMissed = static_cast<std::size_t>(-1);
/// [people] index of each person's prediction, kMissed without one.
std::vector<std::size_t> match(Protocol protocol, std::span<const Skeleton> predicted,
                               std::span<const Skeleton> people);

struct GroupMetrics {
  std::size_t frames = 0, frames_unmatched = 0;  ///< unmatched: somebody is there, and nobody was matched
  std::size_t people = 0, matched = 0, predicted = 0, right_count = 0;
  PoseErrors frame_mean, person_mean;
  std::array<double, kJoints> per_joint{};  ///< mm, mean over people
  double penalised_500 = 0;                 ///< MPJPE over people, 500 mm for each that was missed

  double precision() const;
  double recall() const;
  double f1() const;
  double count_accuracy() const;  ///< share of frames with as many predictions as people
};

/// Of the people who stand alike.
struct PostureMetrics {
  std::size_t people = 0, matched = 0;
  PoseErrors person_mean;  ///< over those matched
};

/// Frames in, figures out.
class Metrics {
 public:
  explicit Metrics(Protocol protocol) : protocol_(protocol) {}
  void add(std::span<const Skeleton> predicted, std::span<const Skeleton> people);
  GroupMetrics all() const { return all_.means(); }
  /// By the number of labelled people.
  std::map<std::size_t, GroupMetrics> by_count() const;
  PostureMetrics by_posture(Posture posture) const;
  Protocol protocol() const { return protocol_; }

 private:
  struct Sums {
    GroupMetrics counts;
    std::size_t frames_matched = 0;
    PoseErrors by_frame, by_person;
    std::array<double, kJoints> joints{};
    GroupMetrics means() const;
  };
  Protocol protocol_;
  Sums all_;
  std::map<std::size_t, Sums> by_count_;
  std::array<PostureMetrics, kPostures> by_posture_;  ///< with sums in the place of means
};

/// {"protocol": .., "n_frames": .., "all": {"mpjpe": .., "err_x": .., "pa_mpjpe": .., "pck20": .., ..},
/// "by_count": {"1": {..}}, "by_posture": {"low": {..}}, "per_joint": [14]}; numbers that do not exist are null.
std::string metrics_json(const Metrics& metrics);

}  // namespace csipose
