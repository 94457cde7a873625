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

/// Where people may be: the capture area, less what stands in it.
struct Stage {
  Rectangle area{0, 0, 4.0, 3.5};
  std::vector<Rectangle> obstacles;
  std::span<const Action> allowed;  ///< at least one
  bool chairs = false;              ///< who sits has a chair: stays there from the first instant to the last
};

/// Hips keep this far inside the area, from furniture, and from other hips (more where arms are spread).
inline constexpr double kInside_m = 0.45, kOffObstacle_m = 0.35, kApart_m = 0.7, kApartSpread_m = 0.9;

/// One who does one thing after another.
class Person final : public Motion {
 public:
  /// `score` from `skipped_s` on; breath and sway are drawn from `rng`.
  Person(Score score, double skipped_s, std::vector<std::pair<double, Action>> doing, CounterRng& rng);

  const Figure& figure() const override { return score_.figure; }
  Stance at(double t_s) const override;
  Action action_at(double t_s) const;
  /// Middle of the seat's upper side and the heading of who sits, when there is a chair.
  struct Chair {
    Vec3 seat{};
    double heading_rad = 0;
  };
  std::optional<Chair> chair;

 private:
  struct Sine {
    double amplitude_m, rate_hz, phase_rad;
    double at(double t_s) const;
  };
  Score score_;
  double skipped_s_;
  std::vector<std::pair<double, Action>> doing_;  ///< from when on
  Sine breath_{};
  std::array<std::array<Sine, 3>, 2> sway_{};  ///< [axis]
};

/// Stature N(1.72 m, 0.08), body mass index 19-29, sides alike within 1.5 %.
Figure draw_figure(CounterRng& rng);

/// `count` people for `seconds`, the same for the same seed and clip. Whoever finds no way among the others in 100 tries
/// stands still where most room is left.
std::vector<std::unique_ptr<Person>> sample_people(const Stage& stage, std::size_t count, double seconds,
                                                   std::uint64_t seed, std::uint32_t clip);

}  // namespace csipose::sim
