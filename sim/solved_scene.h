// sim/solved_scene.h - a room in motion as channels: one per packet, and where people are.
#pragma once

#include <complex>
#include <memory>
#include <span>
#include <vector>

#include "sim/band.h"
#include "sim/fast_solver.h"
#include "sim/moving_scene.h"

namespace csipose::sim {

/// Instants of a moving scene, solved together, which lets shadows be interpolated. All programs solve in batches of kSamples
/// from the first instant on, so that they see the same channel to the last bit; only a data set may ask for fewer.
class SceneBatch {
 public:
  /// For scenes whose still() is the solver's.
  explicit SceneBatch(FastSolver solver, std::size_t samples = kSamples);

  /// The scene's next instants.
  void advance(MovingScene& scene);

  /// H[sample][kSubcarriers][kReceivers][kAntennas], C order.
  std::span<const std::complex<float>> h() const { return h_; }
  Channel channel(std::size_t sample) const;
  const std::vector<Joints>& people(std::size_t sample) const { return people_[sample]; }
  const std::vector<Body>& bodies(std::size_t sample) const { return bodies_[sample]; }

 private:
  FastSolver solver_;
  MovingScene::Snapshot snapshot_;
  std::vector<std::vector<Body>> bodies_;    ///< [sample][body]
  std::vector<std::vector<Joints>> people_;  ///< [sample][person]
  std::vector<std::complex<float>> h_;
};

/// The room at the instant of one packet.
struct Instant {
  Channel channel;
  std::vector<Joints> people;
};

/// A channel that runs on, packet by packet.
class ChannelSource {
 public:
  virtual ~ChannelSource() = default;
  virtual std::size_t people() const = 0;
  /// The next instant of the grid; valid until the next call.
  virtual const Instant& next() = 0;
};

/// Of any moving scene.
std::unique_ptr<ChannelSource> solve_as_it_moves(std::unique_ptr<MovingScene> scene);
/// reflector.h: nobody there, in closed form.
std::unique_ptr<ChannelSource> reflector_channels(double rate_hz);

}  // namespace csipose::sim
