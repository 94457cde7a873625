#include "sim/solved_scene.h"

#include "sim/reflector.h"

namespace csipose::sim {

SceneBatch::SceneBatch(FastSolver solver, std::size_t samples)
    : solver_(std::move(solver)), bodies_(samples), people_(samples), h_(samples * kSubcarriers * kLinks) {}

void SceneBatch::advance(MovingScene& scene) {
  for (std::size_t i = 0; i < bodies_.size(); ++i) {
    scene.next(snapshot_);
    bodies_[i] = snapshot_.bodies;
    people_[i] = snapshot_.people;
  }
  solver_.solve(bodies_, h_);
}

Channel SceneBatch::channel(std::size_t sample) const {
  Channel channel;
  for (std::size_t k = 0; k < kSubcarriers; ++k)
    for (std::size_t r = 0; r < kReceivers; ++r)
      for (std::size_t a = 0; a < kAntennas; ++a)
        channel[r][k][a] = h_[((sample * kSubcarriers + k) * kReceivers + r) * kAntennas + a];
  return channel;
}

namespace {

class SolvedScene final : public ChannelSource {
 public:
  explicit SolvedScene(std::unique_ptr<MovingScene> scene)
      : scene_(std::move(scene)), batch_(FastSolver(scene_->still())) {}
  std::size_t people() const override { return scene_->people(); }
  const Instant& next() override {
    const std::size_t sample = number_++ % kSamples;
    if (sample == 0) batch_.advance(*scene_);
    now_.channel = batch_.channel(sample);
    now_.people = batch_.people(sample);
    return now_;
  }

 private:
  std::unique_ptr<MovingScene> scene_;
  SceneBatch batch_;
  std::uint64_t number_ = 0;
  Instant now_;
};

class Reflector final : public ChannelSource {
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

}  // namespace

std::unique_ptr<ChannelSource> solve_as_it_moves(std::unique_ptr<MovingScene> scene) {
  return std::make_unique<SolvedScene>(std::move(scene));
}
std::unique_ptr<ChannelSource> reflector_channels(double rate_hz) {
  return std::make_unique<Reflector>(rate_hz);
}

}  // namespace csipose::sim
