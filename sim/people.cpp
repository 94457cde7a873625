#include "sim/people.h"

#include <algorithm>
#include <cassert>
#include <cmath>
#include <numbers>

namespace csipose::sim {
namespace {
constexpr double kPi = std::numbers::pi;
constexpr int kPlans = 100, kGoals = 50, kPlaces = 200;
constexpr double kLookEvery_s = 0.1, kShortestWalk_m = 0.6, kMostSkipped_s = 4;
constexpr double kSpread_rad = 0.7;  // an arm further from the body is spread

using People = std::vector<std::unique_ptr<Person>>;

bool is_free(const Stage& stage, const Vec3& p) {
  return stage.area.holds(p, kInside_m) &&
         std::none_of(stage.obstacles.begin(), stage.obstacles.end(),
                      [&](const Rectangle& it) { return it.holds(p, -kOffObstacle_m); });
}

Vec3 draw_place(const Stage& stage, CounterRng& rng) {
  const Rectangle& a = stage.area;
  Vec3 place{};
  for (int i = 0; i < kPlaces; ++i) {
    place = {rng.uniform(a.x0 + kInside_m, a.x1 - kInside_m), rng.uniform(a.y0 + kInside_m, a.y1 - kInside_m),
             0};
    if (is_free(stage, place)) break;
  }
  return place;
}

double apart(const Vec3& a, const Vec3& b) { return std::hypot(a.x - b.x, a.y - b.y); }

bool arms_spread(const Stance& s) {
  for (const std::size_t side : {kLeft, kRight})
    if (glm::dot(s.hands[side] - s.shoulders[side], s.left) * sign_of(side) >
        std::sin(kSpread_rad) * 0.386 * 1.7)
      return true;
  return false;
}

/// How far `p` is from whoever comes nearest, less what is due: not below 0 where all is well.
double room_left(const Person& p, const People& others, double seconds) {
  double least = 1e9;
  for (double t = 0; t <= seconds; t += kLookEvery_s) {
    const Stance own = p.at(t);
    const bool spread = arms_spread(own);
    for (const auto& other : others) {
      const Stance theirs = other->at(t);
      const double due = spread || arms_spread(theirs) ? kApartSpread_m : kApart_m;
      least = std::min(least, apart(own.pelvis, theirs.pelvis) - due);
    }
  }
  return least;
}

bool stays_on_stage(const Person& p, const Stage& stage, double seconds) {
  for (double t = 0; t <= seconds; t += kLookEvery_s)
    if (!is_free(stage, p.at(t).pelvis)) return false;
  return true;
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

std::unique_ptr<Person> draw_plan(const Figure& figure, const Stage& stage, double seconds, CounterRng& rng) {
  Score score(figure, draw_place(stage, rng), rng.uniform(-kPi, kPi));
  std::vector<std::pair<double, Action>> doing;
  const double skipped_s = rng.uniform(0, kMostSkipped_s);
  Action action = stage.allowed[rng.index(static_cast<std::uint32_t>(stage.allowed.size()))];
  const bool on_chair = stage.chairs && action == Action::sit;
  // A fall is the last thing: whoever falls does so in the middle of what is seen.
  double now_s = action == Action::fall ? skipped_s + rng.uniform(0.1, 0.5) * seconds : 0;
  while (now_s < skipped_s + seconds) {
    doing.emplace_back(now_s, action);
    now_s = add(score, action, now_s, stage, rng);
    if (action == Action::fall) break;
    do action = stage.allowed[rng.index(static_cast<std::uint32_t>(stage.allowed.size()))];
    while (action == Action::fall && stage.allowed.size() > 1);
    if (on_chair) action = rng.chance(0.5) ? Action::sit : Action::stand;
  }
  auto person = std::make_unique<Person>(score, skipped_s, std::move(doing), rng);
  if (on_chair) {
    const double heading = score.heading_rad();
    const Vec3 back{-std::cos(heading), -std::sin(heading), 0};
    person->chair = {score.place() + 0.16 * figure.stature_m * back + Vec3{0, 0, kSeat_m}, heading};
  }
  return person;
}

std::unique_ptr<Person> draw_standing(const Figure& figure, const Stage& stage, CounterRng& rng) {
  Score score(figure, draw_place(stage, rng), rng.uniform(-kPi, kPi));
  return std::make_unique<Person>(score, 0, std::vector<std::pair<double, Action>>{{0, Action::stand}}, rng);
}

/// The best of many places to stand.
std::unique_ptr<Person> stand_aside(const Figure& figure, const Stage& stage, const People& others,
                                    double seconds, CounterRng& rng) {
  std::unique_ptr<Person> best;
  double most = -1e9;
  for (int i = 0; i < kPlans; ++i) {
    auto person = draw_standing(figure, stage, rng);
    const double left = room_left(*person, others, seconds);
    if (left > most) most = left, best = std::move(person);
    if (most >= 0) break;
  }
  return best;
}

}  // namespace

double Person::Sine::at(double t_s) const {
  return amplitude_m * std::sin(2 * kPi * rate_hz * t_s + phase_rad);
}

Person::Person(Score score, double skipped_s, std::vector<std::pair<double, Action>> doing, CounterRng& rng)
    : score_(std::move(score)), skipped_s_(skipped_s), doing_(std::move(doing)) {
  breath_ = {rng.uniform(0.002, 0.004), rng.uniform(0.2, 0.33), rng.uniform(0, 2 * kPi)};
  for (auto& axis : sway_)
    for (Sine& sine : axis)
      sine = {rng.uniform(0.002, 0.005) / 3, rng.uniform(0.1, 0.8), rng.uniform(0, 2 * kPi)};
}

Stance Person::at(double t_s) const {
  Posture posture = score_.at(skipped_s_ + t_s);
  for (int axis = 0; axis < 2; ++axis)
    for (const Sine& sine : sway_[static_cast<std::size_t>(axis)]) posture.pelvis[axis] += sine.at(t_s);
  Stance stance = stance_of(score_.figure, posture);
  stance.breath_m = breath_.amplitude_m + breath_.at(t_s);  // half of what the width gains
  return stance;
}

Action Person::action_at(double t_s) const {
  Action now = Action::stand;
  for (const auto& [from_s, action] : doing_)
    if (from_s <= skipped_s_ + t_s) now = action;
  return now;
}

Figure draw_figure(CounterRng& rng) {
  Figure figure(std::clamp(1.72 + 0.08 * rng.normal(), 1.52, 1.92));
  figure.girth = std::sqrt(rng.uniform(19, 29) / 22.5);
  for (const std::size_t side : {kLeft, kRight})
    figure.legs[side] = rng.uniform(0.985, 1.015), figure.arms[side] = rng.uniform(0.985, 1.015);
  return figure;
}

std::vector<std::unique_ptr<Person>> sample_people(const Stage& stage, std::size_t count, double seconds,
                                                   std::uint64_t seed, std::uint32_t clip) {
  assert(!stage.allowed.empty());
  People people;
  for (std::size_t i = 0; i < count; ++i) {
    CounterRng rng(seed, Purpose::persons, static_cast<std::uint16_t>(i), clip, 0);
    const Figure figure = draw_figure(rng);
    std::unique_ptr<Person> person;
    for (int plan = 0; plan < kPlans; ++plan) {
      person = draw_plan(figure, stage, seconds, rng);
      if (stays_on_stage(*person, stage, seconds) && room_left(*person, people, seconds) >= 0) break;
      person.reset();
    }
    people.push_back(person ? std::move(person) : stand_aside(figure, stage, people, seconds, rng));
  }
  return people;
}

}  // namespace csipose::sim
