// tests/model/made_up_background.h - backgrounds and windows in front of them, drawn from a seed.
#pragma once

#include <memory>
#include <numbers>
#include <string>
#include <vector>

#include "model/model.h"
#include "model/seeded_random.h"

namespace csipose::testing {

/// Amplitudes from 10 to 30, phases anywhere on the circle, deviations from 0.2 to 0.5 (phases), 1 to 3 (amplitudes).
inline Background made_up_background(const std::string& name, std::uint64_t seed) {
  SeededRandom random(seed, "background", {});
  Background out{name, {}, {}};
  for (std::size_t e = 0; e < kElements; ++e) {
    const bool phase = e >= kElements / 2;
    out.mean[e] = static_cast<float>(phase ? random.uniform(-std::numbers::pi, std::numbers::pi)
                                           : random.uniform(10, 30));
    out.deviation[e] = static_cast<float>(phase ? random.uniform(0.2, 0.5) : random.uniform(1, 3));
  }
  return out;
}

/// A window whose numbers lie about one deviation from the background, phases brought to (-pi, pi].
inline std::vector<float> window_before(const Background& background, std::uint64_t seed) {
  SeededRandom random(seed, "window", {});
  std::vector<float> x(kChannels * kTokens);
  for (std::size_t c = 0; c < kChannels; ++c)
    for (std::size_t l = 0; l < kLinks; ++l) {
      const std::size_t e = c * kLinks + l;
      const double offset = random.normal();
      for (std::size_t t = 0; t < kSamples; ++t) {
        const double z = offset + 0.1 * random.normal();
        const auto value = background.mean[e] + background.deviation[e] * static_cast<float>(z);
        x[Window::index(c, t, l)] = c < kSubcarriers ? value : wrapped(value);
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
