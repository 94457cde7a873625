// sim/random_room.h - rooms that are drawn, one for each clip of a data set.
//
// The order of draws is part of every data set's identity: never change it.
#pragma once

#include <array>

#include "sim/material.h"
#include "sim/scene.h"

namespace csipose::sim {

struct DevicePlace {
  std::uint32_t wall = 0;  ///< x0, x1, y0, y1
  Vec3 position{};
};
using WallMaterials = std::array<const Material*, kWalls>;
using DevicePlaces = std::array<DevicePlace, kReceivers + 1>;  ///< the transmitter, then the receivers

/// Each concrete, plasterboard, wood or glass.
WallMaterials draw_walls(std::uint64_t seed, std::uint32_t clip);
/// 0.1 m off one of the four walls, 0.5-2 m high, a metre and more apart.
DevicePlaces draw_devices(std::uint64_t seed, std::uint32_t clip, const Vec3& room_m);

/// The room with no device in it.
Scene shoebox(const Vec3& room_m, const WallMaterials& walls);
/// A horizontal array of vertical dipoles half a wavelength apart.
void add_receiver(Scene& scene, const Vec3& centre, const Vec3& axis);
/// How rough the walls of a clip's room are: S uniform in 0..0.35, a directive pattern.
Clutter draw_clutter(std::uint64_t seed, std::uint32_t clip);
/// Which ways of waves a data set has besides those of every scene.
struct Ways {
  int pairs = 13;        ///< by a body: 1, 13 or 49
  bool clutter = false;  ///< walls as rough as draw_clutter() says
};
void set_ways(Scene& scene, const Ways& ways, std::uint64_t seed, std::uint32_t clip);
/// With its devices, arrays along their walls.
Scene random_room(const Vec3& room_m, const WallMaterials& walls, const DevicePlaces& devices);

}  // namespace csipose::sim
