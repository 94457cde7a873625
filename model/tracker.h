// model/tracker.h - who is who from window to window.
//
// Each track carries the last pose and the root's velocity. A detection is compared with that pose moved on
// by the velocity; the assignment with the least sum of mean joint distances wins, within a gate that widens
// while a person is not seen. A detection without a track starts one; a track without a detection waits,
// unpublished, until the timeout.
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
};

class Tracker {
 public:
  explicit Tracker(const TrackerConfig& config = {});
  void configure(const TrackerConfig& config) { config_ = config; }

  /// Gives each person of the window an id, its age, and smoothed joints when asked; then sorts them by id.
  ///   people  at most kMaxPeople, `joints` in the room frame; `joints_raw` receives a copy of them
  ///   now     the window's newest sample; when it lies before the last call's, all tracks are forgotten
  /// Nobody is added: whoever is not seen now is not in the answer. No allocation.
  void update(SteadyTime now, std::span<Person> people);
  /// Forgets everybody. Ids go on from where they were.
  void reset() { tracks_.clear(); }
  std::size_t tracks() const { return tracks_.size(); }

 private:
  struct Track {
    std::uint32_t id = 0;
    SteadyTime born{}, seen{};
    Skeleton joints{};  // as last detected
    std::array<double, 3> velocity_m_per_s{};
    std::array<OneEuro, 3 * kJoints> filters{};
  };
  static constexpr std::size_t kMaxTracks = 32;

  void forget_old(SteadyTime now);
  void fill_costs(SteadyTime now, std::span<const Person> people);
  Track& start(SteadyTime now, const Person& person);
  void follow(Track& track, SteadyTime now, Person& person) const;

  TrackerConfig config_;
  std::vector<Track> tracks_;
  std::vector<double> costs_;
  Assignment assignment_;
  SteadyTime now_{};
  std::uint32_t next_id_ = 1;
};

}  // namespace csipose
