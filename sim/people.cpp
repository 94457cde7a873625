#include "sim/people.h"

#include <algorithm>
#include <cassert>
#include <cmath>

#include "sim/geometry.h"

namespace csipose::sim {
namespace {
constexpr int kPlanTries = 20, kGoals = 50, kPlaces = 200;
constexpr double kLookEvery_s = 0.04, kShortestWalk_m = 0.6, kLongestHeadStart_s = 4, kWait_s = 0.8;
constexpr double kForEver_s = 1e9;
constexpr double kSpread =
    0.6;  // of an arm's length that a hand is aside of its shoulder when arms are spread

Vec3 draw_place(const Stage& stage, CounterRng& rng) {
  const Rectangle& a = stage.area;
  Vec3 place{};
  for (int i = 0; i < kPlaces; ++i) {
    place = {rng.uniform(a.x0 + kInside_m, a.x1 - kInside_m), rng.uniform(a.y0 + kInside_m, a.y1 - kInside_m),
             0};
    if (stage.is_free(place)) break;
  }
  return place;
}

double apart(const Vec3& a, const Vec3& b) { return std::hypot(a.x - b.x, a.y - b.y); }

bool arms_spread(const Figure& figure, const Stance& s) {
  for (const std::size_t side : {kLeft, kRight})
    if (glm::dot(s.hands[side] - s.shoulders[side], s.left) * sign_of(side) >
        kSpread * (figure.upper_arm_m(side) + figure.forearm_m(side)))
      return true;
  return false;
}

/// The place of many at which one comes least near to the others.
Vec3 draw_place_apart(const Stage& stage, std::span<const std::unique_ptr<Person>> others, CounterRng& rng) {
  Vec3 best{};
  double most = -1;
  for (int i = 0; i < kPlaces && most < kApartSpread_m; ++i) {
    const Vec3 place = draw_place(stage, rng);
    double nearest = 1e9;
    for (const auto& other : others) nearest = std::min(nearest, apart(place, other->at(0).pelvis));
    if (nearest > most) most = nearest, best = place;
  }
  return best;
}

/// Writes one action; returns when it is over.
double add(Score& score, Action action, double begin_s, const Stage& stage, CounterRng& rng) {
  if (action == Action::turn)
    return add_turn(score, begin_s, rng.uniform(kPi / 3, kPi) * (rng.chance(0.5) ? 1 : -1), rng);
  if (action != Action::walk) return add_in_place(score, action, begin_s, rng);
  for (int i = 0; i < kGoals; ++i) {
    const Vec3 goal = draw_place(stage, rng);
    if (apart(goal, score.place()) >= kShortestWalk_m) return add_walk(score, begin_s, goal, rng);
  }
  return add_stand(score, begin_s, rng);
}

}  // namespace

bool Stage::is_free(const Vec3& p) const {
  return area.holds(p, kInside_m) &&
         std::none_of(obstacles.begin(), obstacles.end(),
                      [&](const Rectangle& it) { return it.holds(p, -kOffObstacle_m); });
}

Sine draw_breath(CounterRng& rng) {
  return {rng.uniform(0.002, 0.004), rng.uniform(0.2, 0.33), rng.uniform(0, 2 * kPi)};
}

double draw_girth(CounterRng& rng) { return std::sqrt(rng.uniform(19, 29) / 22.5); }

Figure draw_figure(CounterRng& rng) {
  Figure figure(std::clamp(1.72 + 0.08 * rng.normal(), 1.52, 1.92));
  figure.girth = draw_girth(rng);
  for (const std::size_t side : {kLeft, kRight})
    figure.legs[side] = rng.uniform(0.985, 1.015), figure.arms[side] = rng.uniform(0.985, 1.015);
  return figure;
}

double Sine::at(double t_s) const { return amplitude_m * std::sin(2 * kPi * rate_hz * t_s + phase_rad); }

Person::Person(Score score, const CounterRng& rng) : score_(std::move(score)), rng_(rng) {
  breath_ = draw_breath(rng_);
  for (auto& axis : sway_)
    for (Sine& sine : axis)
      sine = {rng_.uniform(0.002, 0.005) / 3, rng_.uniform(0.1, 0.8), rng_.uniform(0, 2 * kPi)};
}

Stance Person::at(double t_s) const {
  Posture posture = score_.at(t_s);
  for (int axis = 0; axis < 2; ++axis)
    for (const Sine& sine : sway_[static_cast<std::size_t>(axis)]) posture.pelvis[axis] += sine.at(t_s);
  Stance stance = stance_of(score_.figure, posture);
  stance.breath_m = breath_.amplitude_m + breath_.at(t_s);  // half of what the width gains
  return stance;
}

Action Person::action_at(double t_s) const {
  const auto after = std::upper_bound(doing_.begin(), doing_.end(), t_s,
                                      [](double t, const auto& it) { return t < it.first; });
  return after == doing_.begin() ? Action::stand : std::prev(after)->second;
}

Crowd::Crowd(Stage stage, std::size_t count, std::uint64_t seed, std::uint32_t clip)
    : stage_(std::move(stage)) {
  assert(!stage_.allowed.empty());
  while (people_.size() < count) add_person(seed, clip);
  plan_until(0);
}

void Crowd::add_person(std::uint64_t seed, std::uint32_t clip) {
  CounterRng rng(seed, Purpose::persons, static_cast<std::uint16_t>(people_.size()), clip, 0);
  const Figure figure = draw_figure(rng);
  const Vec3 place = draw_place_apart(stage_, people_, rng);
  const double heading_rad = rng.uniform(-kPi, kPi);
  auto person = std::make_unique<Person>(Score(figure, place, heading_rad), rng);
  // Nobody begins what they do just when the scene begins.
  person->planned_s_ = -person->rng_.uniform(0, kLongestHeadStart_s);
  if (stage_.chairs && draw_action(*person) == Action::sit) {
    const Vec3 back{-std::cos(heading_rad), -std::sin(heading_rad), 0};
    person->chair_ = {place + 0.16 * figure.stature_m * back + Vec3{0, 0, kSeat_m}, heading_rad};
  }
  people_.push_back(std::move(person));
}

void Crowd::plan_until(double t_s) {
  const auto later = [](const auto& a, const auto& b) { return a->planned_s_ < b->planned_s_; };
  while (!people_.empty()) {
    const auto first = std::min_element(people_.begin(), people_.end(), later);
    if ((*first)->planned_s_ > t_s) return;
    extend(**first);
  }
}

Action Crowd::draw_action(Person& person) const {
  if (person.chair_) return person.rng_.chance(0.5) ? Action::sit : Action::stand;
  return stage_.allowed[person.rng_.index(static_cast<std::uint32_t>(stage_.allowed.size()))];
}

void Crowd::extend(Person& person) {
  const double begin_s = person.planned_s_;
  const Score before = person.score_;
  for (int i = 0; i < kPlanTries; ++i) {
    const Action action = draw_action(person);
    const double end_s = add(person.score_, action, begin_s, stage_, person.rng_);
    if (holds(person, begin_s, end_s)) {
      person.doing_.emplace_back(begin_s, action);
      person.planned_s_ = action == Action::fall ? kForEver_s : end_s;
      return;
    }
    person.score_ = before;
  }
  person.doing_.emplace_back(begin_s, Action::stand);
  person.planned_s_ = begin_s + kWait_s;
}

bool Crowd::holds(const Person& person, double from_s, double to_s) const {
  // Others may have plans beyond: afterwards the person stands in nobody's way.
  for (const auto& other : people_)
    if (other->planned_s_ < kForEver_s) to_s = std::max(to_s, other->planned_s_);
  for (double t = from_s; t <= to_s; t += kLookEvery_s) {
    const Stance own = person.at(t);
    if (!stage_.is_free(own.pelvis)) return false;
    const bool spread = arms_spread(person.figure(), own);
    for (const auto& other : people_) {
      if (other.get() == &person) continue;
      const Stance theirs = other->at(t);
      const double due = spread || arms_spread(other->figure(), theirs) ? kApartSpread_m : kApart_m;
      if (apart(own.pelvis, theirs.pelvis) < due) return false;
    }
  }
  return true;
}

}  // namespace csipose::sim
