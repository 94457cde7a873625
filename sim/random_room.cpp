#include "sim/random_room.h"

#include <algorithm>
#include <vector>

#include "sim/counter_rng.h"

namespace csipose::sim {
namespace {
constexpr double kOffWall_m = 0.1, kDeviceDistance_m = 1.0;
constexpr int kRoomTries = 200;

DevicePlace draw_device(CounterRng& rng, const Vec3& room_m, const std::vector<Vec3>& placed) {
  DevicePlace device;
  for (int attempt = 0; attempt < kRoomTries; ++attempt) {
    device.wall = rng.index(4);
    const double along = rng.uniform(0.15, 0.85), z = rng.uniform(0.5, 2.0);
    const bool on_x = device.wall < 2, far = device.wall % 2 == 1;
    const double off = far ? (on_x ? room_m.x : room_m.y) - kOffWall_m : kOffWall_m;
    device.position = on_x ? Vec3{off, along * room_m.y, z} : Vec3{along * room_m.x, off, z};
    const bool crowded = std::any_of(placed.begin(), placed.end(), [&](const Vec3& p) {
      return glm::distance(p, device.position) < kDeviceDistance_m;
    });
    if (!crowded) break;
  }
  return device;
}

Surface wall_of(const Material& material, double carrier_hz) {
  return {material.permittivity(carrier_hz), material.slab_m};
}

}  // namespace

WallMaterials draw_walls(std::uint64_t seed, std::uint32_t clip) {
  CounterRng rng(seed, Purpose::materials, 0, clip, 0);
  WallMaterials walls{};
  static constexpr std::array kNames{"concrete", "plasterboard", "wood", "glass"};
  for (const Material*& wall : walls) wall = find_material(kNames[rng.index(4)]);
  return walls;
}

DevicePlaces draw_devices(std::uint64_t seed, std::uint32_t clip, const Vec3& room_m) {
  CounterRng rng(seed, Purpose::antennas, 0, clip, 0);
  DevicePlaces devices;
  std::vector<Vec3> placed;
  for (DevicePlace& device : devices) {
    device = draw_device(rng, room_m, placed);
    placed.push_back(device.position);
  }
  return devices;
}

Scene shoebox(const Vec3& room_m, const WallMaterials& walls) {
  Scene scene;
  scene.room.size_m = room_m;
  for (std::size_t w = 0; w < kWalls; ++w) scene.room.walls[w] = wall_of(*walls[w], scene.carrier_hz);
  scene.tones = intel5300_tones();
  return scene;
}

void add_receiver(Scene& scene, const Vec3& centre, const Vec3& axis) {
  const AntennaArray array{centre, axis, scene.wavelength_m() / 2};
  scene.receivers.emplace_back();
  for (std::size_t a = 0; a < kAntennas; ++a) scene.receivers.back().push_back({array.element(a)});
}

Clutter draw_clutter(std::uint64_t seed, std::uint32_t clip) {
  constexpr std::uint16_t kStrength = 100;  // beside the streams of the walls' phases
  Clutter clutter;
  clutter.scattering = CounterRng(seed, Purpose::clutter, kStrength, clip, 0).uniform(0, 0.35);
  clutter.seed = seed;
  clutter.clip = clip;
  return clutter;
}

void set_ways(Scene& scene, const Ways& ways, std::uint64_t seed, std::uint32_t clip) {
  scene.pairs = ways.pairs;
  if (ways.clutter) scene.set_clutter(draw_clutter(seed, clip));
}

Scene random_room(const Vec3& room_m, const WallMaterials& walls, const DevicePlaces& devices) {
  Scene scene = shoebox(room_m, walls);
  scene.transmitter.position = devices[0].position;
  for (std::size_t r = 1; r < devices.size(); ++r)
    add_receiver(scene, devices[r].position, devices[r].wall < 2 ? Vec3{0, 1, 0} : Vec3{1, 0, 0});
  return scene;
}

}  // namespace csipose::sim
