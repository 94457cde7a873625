// sim/counter_rng.h - random numbers that depend on where they are used, not on when.
//
// Philox4x32-10 (Salmon et al., "Parallel random numbers: as easy as 1, 2, 3", SC 2011) turns a key and a
// counter into four words. The key is the seed; the counter says what the numbers are for, in which clip and
// frame. Any clip can hence be made alone, on any number of threads, and is the same to the last bit.
#pragma once

#include <array>
#include <complex>
#include <cstdint>

namespace csipose::sim {

using PhiloxBlock = std::array<std::uint32_t, 4>;

/// Ten rounds of Philox 4x32. Pure.
PhiloxBlock philox4x32(PhiloxBlock counter, std::array<std::uint32_t, 2> key);

/// What a stream of numbers is for. The values are part of every data set's identity: never renumber.
enum class Purpose : std::uint16_t {
  room = 1,
  materials = 2,
  antennas = 3,
  objects = 4,
  persons = 6,
  impair_nic = 7,
  impair_packet = 8,
  clutter = 9
};

/// One stream: the blocks 0, 1, 2... of (seed, purpose, sub, clip, frame); the four words of a block in
/// order.
class CounterRng {
 public:
  CounterRng(std::uint64_t seed, Purpose purpose, std::uint16_t sub, std::uint32_t clip, std::uint32_t frame);

  std::uint32_t word();
  /// In (a, b): never an end of the interval.
  double uniform(double a, double b) { return a + (b - a) * unit(); }
  /// 0..n-1, each equally likely up to 2^-32.
  std::uint32_t index(std::uint32_t n) { return static_cast<std::uint32_t>(std::uint64_t{word()} * n >> 32); }
  /// Mean 0, standard deviation 1. Uses two words.
  double normal() { return complex_normal().real(); }
  /// Real and imaginary part independent, each of mean 0 and standard deviation 1. Uses two words.
  std::complex<double> complex_normal();
  /// Mean 1.
  double exponential();
  bool chance(double probability) { return unit() < probability; }

 private:
  double unit() { return (word() + 0.5) * 0x1p-32; }

  std::array<std::uint32_t, 2> key_;
  PhiloxBlock counter_;
  PhiloxBlock block_{};
  unsigned used_ = 4;
};

}  // namespace csipose::sim
