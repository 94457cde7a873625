#include "sim/counter_rng.h"

#include <cmath>

#include "sim/geometry.h"

namespace csipose::sim {
namespace {
// Multipliers and Weyl increments of Philox4x32, table 2 of the paper.
constexpr std::uint64_t kMultiplier0 = 0xD2511F53, kMultiplier1 = 0xCD9E8D57;
constexpr std::uint32_t kWeyl0 = 0x9E3779B9, kWeyl1 = 0xBB67AE85;

std::uint32_t high(std::uint64_t x) { return static_cast<std::uint32_t>(x >> 32); }
std::uint32_t low(std::uint64_t x) { return static_cast<std::uint32_t>(x); }
}  // namespace

PhiloxBlock philox4x32(PhiloxBlock x, std::array<std::uint32_t, 2> key) {
  for (int round = 0; round < 10; ++round) {
    const std::uint64_t p0 = kMultiplier0 * x[0], p1 = kMultiplier1 * x[2];
    x = {high(p1) ^ x[1] ^ key[0], low(p1), high(p0) ^ x[3] ^ key[1], low(p0)};
    key = {key[0] + kWeyl0, key[1] + kWeyl1};
  }
  return x;
}

CounterRng::CounterRng(std::uint64_t seed, Purpose purpose, std::uint16_t sub, std::uint32_t clip,
                       std::uint32_t frame)
    : key_{low(seed), high(seed)},
      counter_{0, static_cast<std::uint32_t>(purpose) << 16 | sub, clip, frame} {}

std::uint32_t CounterRng::word() {
  if (used_ == 4) {
    block_ = philox4x32(counter_, key_);
    ++counter_[0];
    used_ = 0;
  }
  return block_[used_++];
}

std::complex<double> CounterRng::complex_normal() {
  const double radius = std::sqrt(-2 * std::log(unit()));
  return std::polar(radius, 2 * kPi * unit());
}

double CounterRng::exponential() { return -std::log(unit()); }

}  // namespace csipose::sim
