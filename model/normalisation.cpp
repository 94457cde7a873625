#include "model/normalisation.h"

#include <cassert>
#include <cmath>

namespace csipose {
namespace {

float from_background(const Background& background, std::size_t element, float value) {
  const float difference = value - background.mean[element];
  return (element < kFirstPhase ? difference : wrapped(difference)) / background.deviation[element];
}

/// [c * 9 + l] of the differences of each of a window's samples from its first one, averaged, and added to that: phases may
/// lie on both sides of the cut.
std::array<float, kElements> mean_over_time(std::span<const float> x) {
  std::array<float, kElements> mean;
  for (std::size_t c = 0; c < kChannels; ++c)
    for (std::size_t l = 0; l < kLinks; ++l) {
      const float* samples = &x[c * kTokens + l];
      float sum = 0;
      for (std::size_t t = 0; t < kSamples; ++t) {
        const float difference = samples[t * kLinks] - samples[0];
        sum += c < kSubcarriers ? difference : wrapped(difference);
      }
      const float value = samples[0] + sum / static_cast<float>(kSamples);
      mean[c * kLinks + l] = c < kSubcarriers ? value : wrapped(value);
    }
  return mean;
}

}  // namespace

NearestBackground nearest_background(const std::vector<Background>& backgrounds, std::span<const float> x,
                                     LinkSet links) {
  assert(x.size() == kChannels * kTokens && links.any());
  if (backgrounds.empty()) return {};
  const std::array<float, kElements> mean = mean_over_time(x);
  NearestBackground nearest;
  double least = HUGE_VAL;
  for (const Background& background : backgrounds) {
    double squares = 0, logarithms = 0;
    for (std::size_t e = 0; e < kElements; ++e) {
      if (!links[e % kLinks]) continue;
      const double z = static_cast<double>(from_background(background, e, mean[e]));
      squares += z * z;
      logarithms += std::log(static_cast<double>(background.deviation[e]));
    }
    const double surprise = squares / 2 + logarithms;
    if (nearest.background != nullptr && !(surprise < least)) continue;
    least = surprise;
    nearest = {&background, squares / static_cast<double>(kChannels * links.count())};
  }
  return nearest;
}

void write_tokens(const Normalisation& normalisation, const Background* background, std::span<const float> x,
                  LinkSet links, std::span<float> tokens) {
  assert(tokens.size() == kChannels * kSamples * links.count());
  std::size_t row = 0;
  for (std::size_t i = 0; i < kTokens; ++i) {
    const std::size_t link = i % kLinks;
    if (!links[link]) continue;
    float* token = &tokens[row++ * kChannels];
    for (std::size_t c = 0; c < kChannels; ++c) {
      const float value = x[c * kTokens + i];
      if (background != nullptr)
        token[c] = from_background(*background, c * kLinks + link, value);
      else if (c < kSubcarriers)
        token[c] = (value - normalisation.amp_mean) / normalisation.amp_std;
      else
        token[c] = value / normalisation.ph_std;
    }
  }
}

}  // namespace csipose
