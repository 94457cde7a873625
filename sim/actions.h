// sim/actions.h - what people do: each action writes its notes into a score.
//
// Durations and angles are drawn within 20 % of what is usual. Every action but the fall begins and ends standing, so any
// may follow any. Joint limits hold throughout: knee 0-155, elbow 0-150, shoulder flexion -60-180 degrees (American Academy of
// Orthopaedic Surgeons, Joint Motion, 1965, rounded).
#pragma once

#include <optional>
#include <string_view>

#include "sim/counter_rng.h"
#include "sim/score.h"

namespace csipose::sim {

enum class Action : std::uint8_t { walk, raise_arms, wave, stretch, bend, squat, sit, turn, stand, fall };
inline constexpr std::size_t kActions = 10;
inline constexpr std::array<std::string_view, kActions> kActionNames{
    "walk", "raise_arms", "wave", "stretch", "bend", "squat", "sit", "turn", "stand", "fall"};
inline std::string_view name_of(Action action) { return kActionNames[static_cast<std::size_t>(action)]; }
std::optional<Action> find_action(std::string_view name);

inline constexpr double kKneeLimit_rad = 2.71, kElbowLimit_rad = 2.62, kSeat_m = 0.45;

/// Each writes from `begin_s` on and returns when it is over and the person stands again.
double add_walk(Score& score, double begin_s, const Vec3& goal, CounterRng& rng);
/// Turns on the spot by in-place steps; `turn_rad` to the left.
double add_turn(Score& score, double begin_s, double turn_rad, CounterRng& rng);
double add_raise_arms(Score& score, double begin_s, CounterRng& rng);
double add_wave(Score& score, double begin_s, CounterRng& rng);
double add_stretch(Score& score, double begin_s, CounterRng& rng);
double add_bend(Score& score, double begin_s, CounterRng& rng);
double add_squat(Score& score, double begin_s, CounterRng& rng);
/// On a seat of kSeat_m right behind the heels.
double add_sit(Score& score, double begin_s, CounterRng& rng);
double add_stand(Score& score, double begin_s, CounterRng& rng);
/// Forward, backward or to a side; nobody gets up again.
double add_fall(Score& score, double begin_s, CounterRng& rng);

/// All but walking and turning, which need a goal.
double add_in_place(Score& score, Action action, double begin_s, CounterRng& rng);

}  // namespace csipose::sim
