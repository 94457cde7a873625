#include "sim/recorded_scene.h"

#include "sim/fast_solver.h"
#include "sim/frame_maker.h"
#include "sim/material.h"
#include "sim/reflector.h"
#include "sim/walk.h"

namespace csipose::sim {
namespace {

class Reflector : public RecordedScene {
 public:
  explicit Reflector(double rate_hz) : rate_hz_(rate_hz) {}
  std::size_t people() const override { return 0; }
  const Instant& next() override {
    now_.channel = reflector_channel(scene_, band_, static_cast<double>(number_++) / rate_hz_);
    return now_;
  }

 private:
  Band band_;
  ReflectorScene scene_ = default_reflector_scene(band_);
  double rate_hz_;
  std::uint64_t number_ = 0;
  Instant now_;
};

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

/// Solves kSamples instants at a time, which lets shadows be interpolated.
class Walker : public RecordedScene {
 public:
  explicit Walker(double rate_hz) : rate_hz_(rate_hz), solver_(scene_), h_(kSamples * kSubcarriers * kLinks) {
    const double radius_m = 0.9;
    course_.start = {2.0 + radius_m, 1.75, 0};
    course_.heading_rad = 1.5707963267948966;
    course_.turn_rad_per_m = 1 / radius_m;
  }
  std::size_t people() const override { return 1; }
  const Instant& next() override {
    const std::size_t in_batch = number_ % kSamples;
    if (in_batch == 0) solve_batch();
    now_.channel = channel_of(h_, in_batch);
    now_.people = {joints_[in_batch]};
    ++number_;
    return now_;
  }

 private:
  void solve_batch() {
    std::vector<std::vector<Body>> bodies(kSamples);
    for (std::size_t i = 0; i < kSamples; ++i) {
      const Stance stance =
          stance_of(gait_.figure, walking(gait_, course_, static_cast<double>(number_ + i) / rate_hz_));
      bodies[i] = bodies_of(gait_.figure, stance, skin_);
      joints_[i] = joints_of(gait_.figure, stance);
    }
    solver_.solve(bodies, h_);
  }

  double rate_hz_;
  Scene scene_ = walking_room();
  FastSolver solver_;
  Surface skin_{find_material("skin_dry")->permittivity(scene_.carrier_hz), 0};
  Gait gait_{Figure(1.72), 0.7};
  Course course_;
  std::vector<std::complex<float>> h_;
  std::array<std::array<Vec3, kJoints>, kSamples> joints_;
  std::uint64_t number_ = 0;
  Instant now_;
};

}  // namespace

std::unique_ptr<RecordedScene> reflector_scene(double rate_hz) {
  return std::make_unique<Reflector>(rate_hz);
}
std::unique_ptr<RecordedScene> walking_scene(double rate_hz) { return std::make_unique<Walker>(rate_hz); }

}  // namespace csipose::sim
