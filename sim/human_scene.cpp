#include "sim/human_scene.h"

#include <algorithm>
#include <cmath>

#include "sim/material.h"
#include "sim/random_room.h"

namespace csipose::sim {
namespace {

Rectangle footprint(const Body& body) {
  const double x = body.support_m({1, 0, 0}), y = body.support_m({0, 1, 0});
  return {body.centre.x - x, body.centre.y - y, body.centre.x + x, body.centre.y + y};
}

Stage stage_of(const HumanSpec& spec) {
  Stage stage = stage_of(spec.room);
  stage.allowed = spec.allowed;
  stage.chairs = spec.chairs;
  return stage;
}

/// A seat of 0.42 x 0.42 x 0.04 m; its legs are too thin to matter.
Body chair_body(const Person::Chair& chair, double carrier_hz) {
  Body body;
  body.shape = Shape::box;
  body.half_m = {0.21, 0.21, 0.02};
  body.centre = chair.seat - Vec3{0, 0, 0.02};
  const Vec3 forward{std::cos(chair.heading_rad), std::sin(chair.heading_rad), 0};
  body.axes = {forward, Vec3{-forward.y, forward.x, 0}, Vec3{0, 0, 1}};
  body.surface = {find_material("wood")->permittivity(carrier_hz), 0};
  return body;
}

/// Transmitter at one side of the area, receivers at the others; which side is drawn.
void place_opposite(RoomPlan& plan, CounterRng& rng) {
  const Rectangle& a = plan.area;
  const Vec3 middle{(a.x0 + a.x1) / 2, (a.y0 + a.y1) / 2, 0};
  const std::array<Vec3, 4> sides{Vec3{a.x0 - 0.1, middle.y, 0}, Vec3{a.x1 + 0.1, middle.y, 0},
                                  Vec3{middle.x, a.y0 - 0.1, 0}, Vec3{middle.x, a.y1 + 0.1, 0}};
  const std::uint32_t first = rng.index(4);
  for (std::uint32_t i = 0; i < 4; ++i) {
    const std::uint32_t side = (first + i) % 4;
    const Vec3 along = side < 2 ? Vec3{0, 1, 0} : Vec3{1, 0, 0};
    const Vec3 place = sides[side] + rng.uniform(-0.8, 0.8) * along + Vec3{0, 0, rng.uniform(1.0, 1.4)};
    if (i == 0)
      plan.still.transmitter.position = place;
    else
      add_receiver(plan.still, place, along);
  }
}

bool clear_of_devices(const Scene& scene, const Body& body) {
  const auto near = [&](const Vec3& p) {
    const Rectangle f = footprint(body);
    return f.holds(p, -0.15) && std::abs(p.z - body.centre.z) < body.half_m.z + 0.15;
  };
  if (near(scene.transmitter.position)) return false;
  for (const auto& receiver : scene.receivers)
    for (const Antenna& antenna : receiver)
      if (near(antenna.position)) return false;
  return true;
}

/// A cupboard, a table, a box: standing on the floor, away from devices, with room left for people.
void add_furniture(RoomPlan& plan, CounterRng& rng) {
  static constexpr std::array kMaterials{"chipboard", "wood", "metal"};
  const Vec3& room = plan.still.room.size_m;
  Body body;
  body.shape = Shape::box;
  body.half_m = {rng.uniform(0.15, 0.45), rng.uniform(0.15, 0.45), rng.uniform(0.2, 0.8)};
  body.surface = {find_material(kMaterials[rng.index(3)])->permittivity(plan.still.carrier_hz), 0};
  for (int i = 0; i < 50; ++i) {
    body.centre = {rng.uniform(body.half_m.x + 0.02, room.x - body.half_m.x - 0.02),
                   rng.uniform(body.half_m.y + 0.02, room.y - body.half_m.y - 0.02), body.half_m.z + 0.01};
    const Rectangle& a = plan.area;
    const Rectangle inner{a.x0 + 0.9, a.y0 + 0.9, a.x1 - 0.9, a.y1 - 0.9};
    if (clear_of_devices(plan.still, body) && !inner.holds(body.centre, -0.5)) {
      plan.still.furniture.push_back(body);
      return;
    }
  }
}

}  // namespace

Stage stage_of(const RoomPlan& room) {
  Stage stage;
  stage.area = room.area;
  for (const Body& body : room.still.furniture) stage.obstacles.push_back(footprint(body));
  return stage;
}

void add_person(const Motion& person, double t_s, const Surface& skin, MovingScene::Snapshot& out) {
  const Stance stance = person.at(t_s);
  const std::vector<Body> bodies = bodies_of(person.figure(), stance, skin);
  out.bodies.insert(out.bodies.end(), bodies.begin(), bodies.end());
  out.people.push_back(joints_of(person.figure(), stance));
}

HumanScene::HumanScene(const HumanSpec& spec, std::uint64_t seed, std::uint32_t clip, double rate_hz)
    : still_(spec.room.still),
      crowd_(stage_of(spec), spec.people, seed, clip),
      skin_{find_material("skin_dry")->permittivity(still_.carrier_hz), 0},
      rate_hz_(rate_hz) {
  for (const auto& person : crowd_.people())
    if (person->chair()) still_.furniture.push_back(chair_body(*person->chair(), still_.carrier_hz));
}

void HumanScene::next(Snapshot& out) {
  now_s_ = static_cast<double>(number_++) / rate_hz_;
  crowd_.plan_until(now_s_);
  out.bodies.clear();
  out.people.clear();
  for (const auto& person : crowd_.people()) add_person(*person, now_s_, skin_, out);
}

RoomPlan draw_room(std::uint64_t seed, std::uint32_t clip, bool opposite) {
  CounterRng rng(seed, Purpose::room, 1, clip, 0);
  RoomPlan plan;
  plan.name = "random";
  const std::array<double, 4> margin{rng.uniform(0.2, 1.0), rng.uniform(0.2, 1.0), rng.uniform(0.2, 1.0),
                                     rng.uniform(0.2, 1.0)};
  plan.area = {margin[0], margin[1], margin[0] + 4.0, margin[1] + 3.5};
  const Vec3 size_m{margin[0] + 4.0 + margin[2], margin[1] + 3.5 + margin[3], rng.uniform(2.5, 3.2)};
  const WallMaterials walls = draw_walls(seed, clip);
  plan.still =
      opposite ? shoebox(size_m, walls) : random_room(size_m, walls, draw_devices(seed, clip, size_m));
  if (opposite) place_opposite(plan, rng);
  for (std::uint32_t pieces = rng.index(4); pieces > 0; --pieces) add_furniture(plan, rng);
  return plan;
}

}  // namespace csipose::sim
