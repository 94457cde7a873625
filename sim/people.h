// sim/people.h - who is in the room and what they do: figures, plans that keep people apart, small movements of the living.
#pragma once

#include <memory>
#include <span>
#include <vector>

#include "sim/actions.h"
#include "sim/motion.h"

namespace csipose::sim {

/// A part of the floor, metres, room frame.
struct Rectangle {
  double x0 = 0, y0 = 0, x1 = 0, y1 = 0;

  bool holds(const Vec3& p, double margin_m) const {
    return p.x >= x0 + margin_m && p.x <= x1 - margin_m && p.y >= y0 + margin_m && p.y <= y1 - margin_m;
  }
};

/// Where people may be, and what they may do there.
struct Stage {
  Rectangle area{0, 0, 4.0, 3.5};
  std::vector<Rectangle> obstacles;
  std::vector<Action> allowed;  ///< at least one
  bool chairs = false;          ///< who begins by sitting has a chair, and stays with it

  /// Whether hips may be there.
  bool is_free(const Vec3& p) const;
};

/// Hips keep this far inside the area, from furniture, and from other hips (more where arms are spread).
inline constexpr double kInside_m = 0.45, kOffObstacle_m = 0.35, kApart_m = 0.7, kApartSpread_m = 0.9;

/// One of the small movements that never stop.
struct Sine {
  double amplitude_m = 0, rate_hz = 0, phase_rad = 0;
  double at(double t_s) const;
};
/// The thorax is wider and deeper by 0 to 4-8 mm, 12 to 20 times a minute: half of that, about its middle.
Sine draw_breath(CounterRng& rng);
/// sqrt(body mass index / 22.5), index 19-29.
double draw_girth(CounterRng& rng);
/// Stature N(1.72 m, 0.08), body mass index 19-29, sides alike within 1.5 %.
Figure draw_figure(CounterRng& rng);

/// One who does one thing after another, and breathes and sways meanwhile.
class Person final : public Motion {
 public:
  /// Middle of the seat's upper side and the heading of who sits.
  struct Chair {
    Vec3 seat{};
    double heading_rad = 0;
  };

  Person(Score score, const CounterRng& rng);

  const Figure& figure() const override { return score_.figure; }
  /// Stands where the plan ends beyond it.
  Stance at(double t_s) const override;
  Action action_at(double t_s) const;
  const std::optional<Chair>& chair() const { return chair_; }

 private:
  friend class Crowd;
  Score score_;
  double planned_s_ = 0;                          ///< until when
  std::vector<std::pair<double, Action>> doing_;  ///< from when on
  std::optional<Chair> chair_;
  CounterRng rng_;
  Sine breath_;
  std::array<std::array<Sine, 3>, 2> sway_{};  ///< [axis]
};

/// Everybody in a room. Plans are made action by action, always for whoever is first without one, so that they keep apart
/// for as long as the scene goes on; who finds no way for an action in many tries stands and waits. The same for the same
/// seed and clip, however far ahead one asks.
class Crowd {
 public:
  Crowd(Stage stage, std::size_t count, std::uint64_t seed, std::uint32_t clip);

  /// Makes sure that everybody has something to do until then. at() may be asked up to the last such instant.
  void plan_until(double t_s);
  std::span<const std::unique_ptr<Person>> people() const { return people_; }

 private:
  void add_person(std::uint64_t seed, std::uint32_t clip);
  void extend(Person& person);
  Action draw_action(Person& person) const;
  bool holds(const Person& person, double from_s, double to_s) const;

  Stage stage_;
  std::vector<std::unique_ptr<Person>> people_;
};

}  // namespace csipose::sim
