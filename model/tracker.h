// model/tracker.h - who is who from window to window, and how surely somebody is there.
//
// Each track carries the last pose, the root's velocity and a score. A detection is compared with that pose moved on
// by the velocity; the assignment with the least sum of mean joint distances wins, within a gate that widens
// while a person is not seen; of tracks as near, the one with the higher score. A detection without a track starts one; a track
// without a detection waits, unpublished, until the timeout.
//
// A track's score is the mean of its detections' scores over the last moments, exponentially weighted, where windows without it
// count as 0. Errors of single windows fall out of it: somebody whom a window is less sure of stays, somebody whom a window sees
// and the next ones do not never appears.
#pragma once

#include <array>
#include <cstdint>
#include <span>
#include <vector>

#include "model/assignment.h"
#include "model/one_euro.h"
#include "proto/pose.h"
#include "proto/time.h"

namespace csipose {

struct TrackerConfig {
  Nanoseconds timeout = std::chrono::milliseconds(1000);  ///< a person not seen for longer is a new one
  bool smooth = false;                                    ///< one-euro filter on every coordinate
  Nanoseconds score_memory{};  ///< time constant of the score's mean; 0: each window speaks for itself
  float min_score = 0;         ///< whose track is below is followed and not published
  std::size_t max_people = kMaxPeople;  ///< those with the highest scores are published
};

class Tracker {
 public:
  explicit Tracker(const TrackerConfig& config = {});
  void configure(const TrackerConfig& config) { config_ = config; }

  /// Gives each person of the window its track's score, and to those who are published an id, their age, and smoothed joints when
  /// asked; puts these first, sorted by id, and returns how many they are.
  ///   people  at most kMaxPeople, `joints` in the room frame; `joints_raw` receives a copy of them
  ///   now     the window's newest sample; when it lies before the last call's, all tracks are forgotten
  /// Nobody is added: whoever is not seen now is not in the answer. No allocation.
  std::size_t update(SteadyTime now, std::span<Person> people);
  /// Forgets everybody. Ids go on from where they were.
  void reset() {
    tracks_.clear();
    begun_ = false;
  }
  std::size_t tracks() const { return tracks_.size(); }

 private:
  struct Track {
    std::uint32_t id = 0;  // 0: not published yet
    SteadyTime born{}, seen{};
    double score = 0;
    Skeleton joints{};  // as last detected
    std::array<double, 3> velocity_m_per_s{};
    std::array<OneEuro, kPoseWidth> filters{};
  };
  static constexpr std::size_t kMaxTracks = 32;

  void forget_old(SteadyTime now);
  void forget_scores(SteadyTime now);
  void fill_costs(SteadyTime now, std::span<const Person> people);
  Track& start(SteadyTime now, const Person& person);
  void follow(Track& track, SteadyTime now, Person& person);
  std::size_t publish(std::span<Person> people) const;

  TrackerConfig config_;
  std::vector<Track> tracks_;
  std::vector<double> costs_;
  Assignment assignment_;
  SteadyTime now_{};
  bool begun_ = false;        // since the last reset
  double window_weight_ = 1;  // of this window in the scores
  std::uint32_t next_id_ = 1;
};

}  // namespace csipose
