#include "model/tracker.h"

#include <algorithm>
#include <cassert>
#include <cmath>

namespace csipose {
namespace {

// Set by reasoning about walking people (1.5 m/s) and poses that are off by 0.1 m, not tuned on data.
constexpr double kGate_m = 0.5;  // mean joint distance of the same person from one window to the next
constexpr double kGateGrowth_m_per_s = 1.5;  // a person out of sight may have turned round
constexpr double kMaxPrediction_s = 0.5;     // nobody walks straight on for ever
constexpr double kVelocityMemory_s = 0.15;   // about five windows at 30 a second
constexpr double kForbidden = 1e6;           // more than any sum of allowed distances

std::array<double, 3> coordinates(const Point3& p) {
  return {static_cast<double>(p.x), static_cast<double>(p.y), static_cast<double>(p.z)};
}

/// Mean distance of the joints of `pose` to those of `earlier` moved by `shift`.
double mean_joint_distance(const Skeleton& pose, const Skeleton& earlier,
                           const std::array<double, 3>& shift) {
  double sum = 0;
  for (std::size_t j = 0; j < kJoints; ++j) {
    const auto a = coordinates(pose[j]), b = coordinates(earlier[j]);
    sum += std::hypot(a[0] - b[0] - shift[0], a[1] - b[1] - shift[1], a[2] - b[2] - shift[2]);
  }
  return sum / static_cast<double>(kJoints);
}

std::array<double, 3> root_of(const Skeleton& joints) {
  const auto l = coordinates(joints[kLeftHip]), r = coordinates(joints[kRightHip]);
  return {(l[0] + r[0]) / 2, (l[1] + r[1]) / 2, (l[2] + r[2]) / 2};
}

}  // namespace

Tracker::Tracker(const TrackerConfig& config) : config_(config), assignment_(kMaxTracks, kMaxPeople) {
  tracks_.reserve(kMaxTracks);
  costs_.reserve(kMaxTracks * kMaxPeople);
}

void Tracker::update(SteadyTime now, std::span<Person> people) {
  assert(people.size() <= kMaxPeople);
  forget_old(now);
  fill_costs(now, people);
  const std::size_t old_tracks = tracks_.size();
  const auto person_of_track = assignment_.solve(costs_, old_tracks, people.size());
  std::array<bool, kMaxPeople> known{};
  for (std::size_t t = 0; t < old_tracks; ++t) {
    const std::size_t p = person_of_track[t];
    if (p == kUnassigned || costs_[t * people.size() + p] >= kForbidden) continue;
    known[p] = true;
    follow(tracks_[t], now, people[p]);
  }
  for (std::size_t p = 0; p < people.size(); ++p)
    if (!known[p]) follow(start(now, people[p]), now, people[p]);
  std::sort(people.begin(), people.end(), [](const Person& a, const Person& b) { return a.id < b.id; });
}

void Tracker::forget_old(SteadyTime now) {
  if (now < now_) reset();
  now_ = now;
  std::erase_if(tracks_, [&](const Track& track) { return now - track.seen > config_.timeout; });
}

void Tracker::fill_costs(SteadyTime now, std::span<const Person> people) {
  costs_.assign(tracks_.size() * people.size(), kForbidden);
  for (std::size_t t = 0; t < tracks_.size(); ++t) {
    const Track& track = tracks_[t];
    const double unseen_s = seconds(now - track.seen);
    const double gate_m = kGate_m + kGateGrowth_m_per_s * unseen_s;
    std::array<double, 3> shift = track.velocity_m_per_s;
    for (double& s : shift) s *= std::min(unseen_s, kMaxPrediction_s);
    for (std::size_t p = 0; p < people.size(); ++p) {
      const double distance_m = mean_joint_distance(people[p].joints, track.joints, shift);
      if (distance_m <= gate_m) costs_[t * people.size() + p] = distance_m;
    }
  }
}

/// With all places taken, the one who has been out of sight longest makes room; there are more places than
/// people in a window, so that is never somebody seen now.
Tracker::Track& Tracker::start(SteadyTime now, const Person& person) {
  static_assert(kMaxTracks >= 2 * kMaxPeople);
  Track track;
  track.id = next_id_++;
  track.born = track.seen = now;
  track.joints = person.joints;
  if (tracks_.size() < kMaxTracks) return tracks_.emplace_back(track);
  const auto longest = std::min_element(tracks_.begin(), tracks_.end(),
                                        [](const Track& a, const Track& b) { return a.seen < b.seen; });
  return *longest = track;
}

void Tracker::follow(Track& track, SteadyTime now, Person& person) const {
  const double dt_s = seconds(now - track.seen);
  const auto before = root_of(track.joints), after = root_of(person.joints);
  if (dt_s > 0)
    for (std::size_t i = 0; i < 3; ++i)
      track.velocity_m_per_s[i] += (1 - std::exp(-dt_s / kVelocityMemory_s)) *
                                   ((after[i] - before[i]) / dt_s - track.velocity_m_per_s[i]);
  track.seen = now;
  track.joints = person.joints_raw = person.joints;
  person.id = track.id;
  person.age_ms = static_cast<std::uint32_t>((now - track.born) / std::chrono::milliseconds(1));
  if (!config_.smooth) {
    track.filters = {};  // switched on later, they start from there
    return;
  }
  for (std::size_t j = 0; j < kJoints; ++j) {
    OneEuro* filters = &track.filters[3 * j];
    const auto raw = coordinates(person.joints[j]);
    person.joints[j] = {static_cast<float>(filters[0].filter(raw[0], dt_s)),
                        static_cast<float>(filters[1].filter(raw[1], dt_s)),
                        static_cast<float>(filters[2].filter(raw[2], dt_s))};
  }
}

}  // namespace csipose
