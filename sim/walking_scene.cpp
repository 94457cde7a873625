#include "sim/walking_scene.h"

#include "sim/material.h"
#include "sim/walk.h"

namespace csipose::sim {
namespace {

Surface wall_of(const char* material, double carrier_hz) {
  return {find_material(material)->permittivity(carrier_hz), find_material(material)->slab_m};
}

Scene walking_room() {
  Scene scene;
  const char* materials[kWalls] = {"plasterboard", "plasterboard", "concrete",
                                   "plasterboard", "concrete",     "concrete"};
  for (std::size_t w = 0; w < kWalls; ++w) scene.room.walls[w] = wall_of(materials[w], scene.carrier_hz);
  scene.tones = intel5300_tones();
  scene.transmitter.position = {0.1, 1.75, 1.0};
  const double spacing_m = scene.wavelength_m() / 2;
  for (const AntennaArray& array : {AntennaArray{{3.9, 0.5, 1.0}, {0, 1, 0}, spacing_m},
                                    AntennaArray{{2.0, 3.4, 1.0}, {1, 0, 0}, spacing_m},
                                    AntennaArray{{2.0, 0.1, 1.0}, {1, 0, 0}, spacing_m}}) {
    scene.receivers.emplace_back();
    for (std::size_t a = 0; a < kAntennas; ++a) scene.receivers.back().push_back({array.element(a)});
  }
  return scene;
}

class WalkingScene final : public MovingScene {
 public:
  explicit WalkingScene(double rate_hz) : rate_hz_(rate_hz) {
    const double radius_m = 0.9;
    course_.start = {2.0 + radius_m, 1.75, 0};
    course_.heading_rad = 1.5707963267948966;
    course_.turn_rad_per_m = 1 / radius_m;
  }
  const Scene& still() const override { return still_; }
  std::size_t people() const override { return 1; }
  void next(Snapshot& out) override {
    const Stance stance =
        stance_of(gait_.figure, walking(gait_, course_, static_cast<double>(number_++) / rate_hz_));
    out.bodies = bodies_of(gait_.figure, stance, skin_);
    out.people.assign(1, joints_of(gait_.figure, stance));
  }

 private:
  double rate_hz_;
  Scene still_ = walking_room();
  Surface skin_{find_material("skin_dry")->permittivity(still_.carrier_hz), 0};
  Gait gait_{Figure(1.72), 0.7};
  Course course_;
  std::uint64_t number_ = 0;
};

}  // namespace

std::unique_ptr<MovingScene> walking_scene(double rate_hz) { return std::make_unique<WalkingScene>(rate_hz); }

}  // namespace csipose::sim
