// model/seeded_random.h - random numbers that depend on a seed and on what they are for, not on when they are drawn.
#pragma once

#include <cmath>
#include <cstddef>
#include <cstdint>
#include <initializer_list>
#include <numbers>
#include <string_view>

namespace csipose {

/// SplitMix64 (Steele, Lea, Flood 2014). One stream for each (seed, purpose, indices): the draws of a tensor, of a
/// sample in an epoch, of a step.
class SeededRandom {
 public:
  SeededRandom(std::uint64_t seed, std::string_view purpose,
               std::initializer_list<std::uint64_t> indices = {})
      : state_(seed) {
    for (const char c : purpose) mix(static_cast<unsigned char>(c));
    for (const std::uint64_t index : indices) {
      mix(index);
      next();  // spreads neighbouring indices over all bits
    }
  }
  std::uint64_t next() {
    std::uint64_t z = state_ += 0x9e3779b97f4a7c15;
    z = (z ^ (z >> 30)) * 0xbf58476d1ce4e5b9;
    z = (z ^ (z >> 27)) * 0x94d049bb133111eb;
    return z ^ (z >> 31);
  }
  /// In [0, 1).
  double uniform() { return static_cast<double>(next() >> 11) * 0x1p-53; }
  double uniform(double from, double to) { return from + (to - from) * uniform(); }
  /// 0 .. n - 1, each equally likely up to n / 2^53.
  std::size_t index(std::size_t n) { return static_cast<std::size_t>(uniform() * static_cast<double>(n)); }
  /// Mean 0, standard deviation 1 (Box-Muller).
  double normal() {
    const double radius = std::sqrt(-2 * std::log(1 - uniform()));
    return radius * std::cos(2 * std::numbers::pi * uniform());
  }

 private:
  void mix(std::uint64_t word) { state_ = (state_ ^ word) * 0x100000001b3; }  // FNV-1a

  std::uint64_t state_;
};

}  // namespace csipose
