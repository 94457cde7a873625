// sim/fast_solver.h - the channel of a scene, fast: what data sets and the live feed are made with.
//
// The same physics as the reference solver, within 1 % of its rms (3 % of what moves). What makes it fast:
//   - paths by walls and furniture only are static: each is one row of tones, made once, exactly; a snapshot adds (F - 1)
//     times the shadowed rows
//   - shadows of these paths are computed at every second snapshot and cubically interpolated in time
//   - reflections by bodies are solved at every fourth snapshot and at the middle of each array; their amplitudes and lengths
//     are interpolated in time and carried to the antennas along the ray
//   - reflection coefficients come from tables over the angle
//   - outlines, Newton's steps, near-checks and tones go sixteen at a time (fast_kernels.h)
// One thread; give each thread its own solver. Results do not depend on how work is spread.
#pragma once

#include <memory>
#include <span>

#include "sim/fast_kernels.h"
#include "sim/scene.h"

namespace csipose::sim {

class FastSolver {
 public:
  /// Takes everything of `scene` but its bodies. Arrays are lines of antennas with one axis and pattern.
  explicit FastSolver(const Scene& scene, const FastKernels& kernels = best_kernels());
  ~FastSolver();
  /// A copy has the static paths without computing them again: for many clips in one room.
  FastSolver(const FastSolver& other);

  /// bodies[snapshot][body]: the same bodies in the same order at each snapshot.
  /// out: H[snapshot][tone][receiver][antenna], C order.
  void solve(std::span<const std::vector<Body>> bodies, std::span<std::complex<float>> out);

 private:
  class Impl;
  std::unique_ptr<Impl> impl_;
};

/// Where the scene's bodies are at each of its snapshots.
std::vector<std::vector<Body>> bodies_over_time(const Scene& scene);

/// H[snapshot][tone][receiver][antenna] of a whole scene.
std::vector<std::complex<float>> solve_fast(const Scene& scene, const FastKernels& kernels = best_kernels());

}  // namespace csipose::sim
