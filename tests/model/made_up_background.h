// tests/model/made_up_background.h - backgrounds and windows in front of them, drawn from a seed.
#pragma once

#include <array>
#include <complex>
#include <memory>
#include <numbers>
#include <string>
#include <vector>

#include "model/model.h"
#include "model/seeded_random.h"

namespace csipose::testing {

/// Amplitudes from 10 to 30, phases anywhere on the circle, deviations from 1 to 3.
inline Background made_up_background(const std::string& name, std::uint64_t seed) {
  SeededRandom random(seed, "background", {});
  Background out{name, {}, {}};
  for (std::size_t e = 0; e < kElements; ++e) {
    out.response[e] = static_cast<float>(
        e >= kFirstPhase ? random.uniform(-std::numbers::pi, std::numbers::pi) : random.uniform(10, 30));
    out.deviation[e] = static_cast<float>(random.uniform(1, 3));
  }
  return out;
}

/// The line of phase and the gain that a packet has at a receiver.
struct PacketLine {
  double offset = 0, slope = 0, gain = 1;
};

/// Amplitude and phase, in (-pi, pi], of gain exp(i (offset + slope (n - 14.5))) (response + departure).
inline void write_response(const Background& background, std::size_t n, std::size_t link,
                           std::complex<double> departure, const PacketLine& line, float& amplitude,
                           float& phase) {
  const std::size_t e = n * kLinks + link;
  const std::complex<double> there = static_cast<double>(background.response[e]) + departure,
                             turned = std::polar(
                                 line.gain, static_cast<double>(background.response[kFirstPhase + e]) +
                                                line.offset + line.slope * (static_cast<double>(n) - 14.5));
  amplitude = static_cast<float>(std::abs(there * turned));
  phase = static_cast<float>(std::arg(there * turned));
}

/// A window whose departures are about the background's deviations; its packets' phases have lines of their own, and their
/// powers differ by a few percent.
inline std::vector<float> window_before(const Background& background, std::uint64_t seed) {
  SeededRandom random(seed, "window", {});
  std::vector<float> x(kChannels * kTokens);
  std::array<PacketLine, kSamples * kReceivers> lines;
  for (PacketLine& line : lines)
    line = {random.uniform(-std::numbers::pi, std::numbers::pi), random.uniform(-0.3, 0.3),
            random.uniform(0.95, 1.05)};
  for (std::size_t n = 0; n < kSubcarriers; ++n)
    for (std::size_t l = 0; l < kLinks; ++l) {
      const double in_phase = random.normal(), across = random.normal();
      for (std::size_t t = 0; t < kSamples; ++t) {
        const std::size_t e = n * kLinks + l;
        const std::complex<double> departure(
            static_cast<double>(background.deviation[e]) * (in_phase + 0.1 * random.normal()),
            static_cast<double>(background.deviation[kFirstPhase + e]) * (across + 0.1 * random.normal()));
        write_response(background, n, l, departure, lines[t * kReceivers + l / kAntennas],
                       x[Window::index(n, t, l)], x[Window::index(kSubcarriers + n, t, l)]);
      }
    }
  return x;
}

/// The weights of a file with these backgrounds added.
inline std::shared_ptr<const Model> with_backgrounds(std::vector<std::uint8_t> bytes,
                                                     const std::vector<Background>& backgrounds) {
  bytes = csipose::with_backgrounds(SafetensorsFile::parse(bytes, "plain"), backgrounds);
  return Model::from(SafetensorsFile::parse(bytes, "with backgrounds"));
}

}  // namespace csipose::testing
