// sim/object_clip.h - sim-object: random rooms with one to four solids that fly about and bounce.
//
// Made for pre-training: no labels, only variety. A clip is one room, one placement of devices and one flight of objects;
// seed and clip number say everything. The order of draws is part of every data set's identity: never change it.
#pragma once

#include <glm/gtc/quaternion.hpp>
#include <vector>

#include "sim/counter_rng.h"
#include "sim/material.h"
#include "sim/moving_scene.h"
#include "sim/random_room.h"

namespace csipose::sim {

enum class ObjectKind : std::uint8_t { sphere, cube, cylinder, ellipsoid };

struct FlyingObject {
  ObjectKind kind = ObjectKind::sphere;
  double radius_m = 0.3;        ///< of the bounding sphere, which is what collides
  double slimness[2] = {0, 0};  ///< 0..1: cylinder's radius; ellipsoid's two shorter axes
  const Material* material = nullptr;
  Vec3 position{}, velocity_m_s{}, spin_rad_s{};
  glm::dquat rotation{1, 0, 0, 0};

  /// As the solver takes it; `surface` is that of `material`.
  Body body(const Surface& surface) const;
};

struct ObjectClip {
  Vec3 room_m{};
  WallMaterials walls{};
  std::array<DevicePlace, kReceivers + 1> devices;  ///< transmitter, receivers
  std::vector<FlyingObject> objects;

  /// Objects fly on for dt: walls and devices turn them back, they collide elastically, none exceeds 3 m/s.
  void step(double dt_s);
};

ObjectClip sample_object_clip(std::uint64_t seed, std::uint32_t clip);
/// The clip as it runs on.
std::unique_ptr<MovingScene> object_scene(std::uint64_t seed, std::uint32_t clip, double rate_hz,
                                          Ways ways = {});

}  // namespace csipose::sim
