#include "model/tracker.h"

#include <algorithm>
#include <cassert>
#include <cmath>
#include <tuple>

namespace csipose {
namespace {

// Set by reasoning about walking people (1.5 m/s) and poses that are off by 0.1 m, not tuned on data.
constexpr double kGate_m = 0.5;  // mean joint distance of the same person from one window to the next
constexpr double kGateGrowth_m_per_s = 1.5;  // a person out of sight may have turned round
constexpr double kMaxPrediction_s = 0.5;     // nobody walks straight on for ever
constexpr double kVelocityMemory_s = 0.15;   // about five windows at 30 a second
constexpr double kForbidden = 1e6;           // more than any sum of allowed distances
constexpr double kNearerIfSure_m = 0.3;  // by which a track of score 1 counts as nearer than one of score 0

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

}  // namespace

Tracker::Tracker(const TrackerConfig& config) : config_(config), assignment_(kMaxTracks, kMaxPeople) {
  tracks_.reserve(kMaxTracks);
  costs_.reserve(kMaxTracks * kMaxPeople);
}

std::size_t Tracker::update(SteadyTime now, std::span<Person> people) {
  assert(people.size() <= kMaxPeople);
  forget_scores(now);
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
  return publish(people);
}

void Tracker::forget_scores(SteadyTime now) {
  if (now < now_) reset();
  const double memory_s = seconds(config_.score_memory);
  const double kept = memory_s > 0 && begun_ ? std::exp(-seconds(now - now_) / memory_s) : 0;
  begun_ = true;
  window_weight_ = 1 - kept;
  for (Track& track : tracks_) track.score *= kept;
}

void Tracker::forget_old(SteadyTime now) {
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
      if (distance_m <= gate_m) costs_[t * people.size() + p] = distance_m - kNearerIfSure_m * track.score;
    }
  }
}

/// With all places taken, of those who are not seen now the one with the least score makes room, or the one out of
/// sight longest; there are more places than people in two windows.
Tracker::Track& Tracker::start(SteadyTime now, const Person& person) {
  static_assert(kMaxTracks >= 2 * kMaxPeople);
  Track track;
  track.born = track.seen = now;
  track.joints = person.joints;
  if (tracks_.size() < kMaxTracks) return tracks_.emplace_back(track);
  return *std::ranges::min_element(tracks_, {}, [&](const Track& it) {
    return std::tuple(it.seen == now, it.score, it.seen);
  }) = track;
}

void Tracker::follow(Track& track, SteadyTime now, Person& person) {
  track.score += window_weight_ * static_cast<double>(person.score);
  person.score = static_cast<float>(track.score);
  if (track.id == 0 && person.score >= config_.min_score) track.id = next_id_++;
  const double dt_s = seconds(now - track.seen);
  const auto before = coordinates(root_of(track.joints)), after = coordinates(root_of(person.joints));
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

std::size_t Tracker::publish(std::span<Person> people) const {
  const auto rest = std::partition(people.begin(), people.end(), [&](const Person& person) {
    return person.id != 0 && person.score >= config_.min_score;
  });
  const auto likely = std::span(people.begin(), rest);
  std::ranges::sort(likely, [](const Person& a, const Person& b) {
    return a.score != b.score ? a.score > b.score : a.id < b.id;
  });
  const auto published = likely.first(std::min(likely.size(), config_.max_people));
  std::ranges::sort(published, {}, &Person::id);
  return published.size();
}

}  // namespace csipose
