#include "model/normalisation.h"

#include <algorithm>
#include <cassert>
#include <cmath>
#include <complex>

namespace csipose {
namespace {

using Complex = std::complex<float>;
using Sample = WindowSample;

/// exp(-i slope (n - 14.5)).
std::array<Complex, kSubcarriers> line(float slope) {
  std::array<Complex, kSubcarriers> turns;
  const Complex step = std::polar(1.f, -slope);
  Complex turn = std::polar(1.f, slope * kMiddleSubcarrier);
  for (Complex& it : turns) {
    it = turn;
    turn *= step;
  }
  return turns;
}

/// sum c exp(-i slope (n - 14.5)), and the same of c (n - 14.5) and of c (n - 14.5)^2.
struct LineSums {
  Complex sum, first, second;
};
LineSums sums_along(const std::array<Complex, kSubcarriers>& c, float slope) {
  LineSums out;
  const auto turns = line(slope);
  for (std::size_t n = 0; n < kSubcarriers; ++n) {
    const Complex turned = c[n] * turns[n];
    const float from_middle = static_cast<float>(n) - kMiddleSubcarrier;
    out.sum += turned;
    out.first += turned * from_middle;
    out.second += turned * (from_middle * from_middle);
  }
  return out;
}

/// The slope at which |sum c exp(-i slope (n - 14.5))| is largest: the best of a grid, then Newton's steps.
float steepest(const std::array<Complex, kSubcarriers>& c) {
  static const auto kLines = [] {
    std::array<std::array<Complex, kSubcarriers>, kSlopes> lines;
    for (std::size_t i = 0; i < kSlopes; ++i) lines[i] = line(slope_of(i));
    return lines;
  }();
  std::size_t best = 0;
  float most = -1;
  for (std::size_t i = 0; i < kSlopes; ++i) {
    float re = 0, im = 0;
    for (std::size_t n = 0; n < kSubcarriers; ++n) {
      re += c[n].real() * kLines[i][n].real() - c[n].imag() * kLines[i][n].imag();
      im += c[n].real() * kLines[i][n].imag() + c[n].imag() * kLines[i][n].real();
    }
    const float power = re * re + im * im;
    if (power > most) most = power, best = i;
  }
  float slope = slope_of(best);
  for (int i = 0; i < kNewtonSteps; ++i) {
    const LineSums s = sums_along(c, slope);
    const float rise = (std::conj(s.sum) * s.first).imag();  // half the derivative of |sum|^2
    const float bend = std::norm(s.first) - (std::conj(s.sum) * s.second).real();
    if (bend < 0) slope -= std::clamp(rise / bend, -kSlopeStep / 2, kSlopeStep / 2);
  }
  return slope;
}

void depart(const Background& background, std::span<const float> sample, LinkSet links, std::size_t receiver,
            Sample& out) {
  std::array<std::array<Complex, kSubcarriers>, kAntennas> turned;  // by the background's phase
  std::array<Complex, kSubcarriers> weighed{};
  float power = 0;
  for (std::size_t a = 0; a < kAntennas; ++a) {
    const std::size_t link = receiver * kAntennas + a;
    if (!links[link]) continue;
    for (std::size_t n = 0; n < kSubcarriers; ++n) {
      const std::size_t e = n * kLinks + link;
      const float phase = sample[kFirstPhase + e] - background.response[kFirstPhase + e];
      turned[a][n] = {sample[e] * std::cos(phase), sample[e] * std::sin(phase)};
      weighed[n] += background.response[e] * turned[a][n];
      power += sample[e] * sample[e];
    }
  }
  const float slope = steepest(weighed);
  const Complex sum = sums_along(weighed, slope).sum;
  const Complex scale = power > 0 ? std::conj(sum) / power : 0;  // g exp(-i a), as |sum| = g power
  const auto turns = line(slope);
  for (std::size_t a = 0; a < kAntennas; ++a) {
    const std::size_t link = receiver * kAntennas + a;
    if (!links[link]) continue;
    for (std::size_t n = 0; n < kSubcarriers; ++n) {
      const std::size_t e = n * kLinks + link;
      const Complex over = turned[a][n] * turns[n] * scale;
      out[e] = over.real() - background.response[e];
      out[kFirstPhase + e] = over.imag();
    }
  }
}

/// Sample t of a window, [c * 9 + l].
Sample sample_of(std::span<const float> x, std::size_t t) {
  Sample sample;
  for (std::size_t c = 0; c < kChannels; ++c)
    std::copy_n(&x[c * kTokens + t * kLinks], kLinks, &sample[c * kLinks]);
  return sample;
}

/// A sample's elements as the network is given them.
Sample scaled(const Normalisation& normalisation, const Background* background, const Sample& sample,
              LinkSet links) {
  if (background != nullptr) {
    Sample departed = departures(*background, sample, links);
    for (std::size_t e = 0; e < kElements; ++e) departed[e] /= background->deviation[e];
    return departed;
  }
  Sample out;
  for (std::size_t e = 0; e < kElements; ++e)
    out[e] = e < kFirstPhase ? (sample[e] - normalisation.amp_mean) / normalisation.amp_std
                             : sample[e] / normalisation.ph_std;
  return out;
}

}  // namespace

std::array<float, kElements> departures(const Background& background, std::span<const float> sample,
                                        LinkSet links) {
  assert(sample.size() == kElements);
  Sample out{};
  for (std::size_t receiver = 0; receiver < kReceivers; ++receiver)
    depart(background, sample, links, receiver, out);
  return out;
}

Fit fit_of(const Background& background, std::span<const float> sample, LinkSet links) {
  assert(links.any());
  const Sample departed = departures(background, sample, links);
  double squares = 0, surprise = 0;
  for (std::size_t e = 0; e < kElements; ++e) {
    if (!links[e % kLinks]) continue;
    const auto deviation = static_cast<double>(background.deviation[e]);
    const double square = std::pow(static_cast<double>(departed[e]) / deviation, 2);
    squares += square;
    surprise += kTailShape * std::log1p(square / kFreedom) + std::log(deviation);
  }
  return {squares / static_cast<double>(kChannels * links.count()), surprise};
}

WindowSample middle_sample(std::span<const float> x) { return sample_of(x, kSamples / 2); }

NearestBackground nearest_background(const std::vector<Background>& backgrounds, std::span<const float> x,
                                     LinkSet links) {
  assert(x.size() == kChannels * kTokens && links.any());
  if (backgrounds.empty()) return {};
  const Sample middle = middle_sample(x);
  NearestBackground nearest;
  double least = HUGE_VAL;
  for (const Background& background : backgrounds) {
    const Fit fit = fit_of(background, middle, links);
    if (nearest.background != nullptr && !(fit.surprise < least)) continue;
    least = fit.surprise;
    nearest = {&background, fit.unlikeness};
  }
  return nearest;
}

std::array<float, kElements> mobility(const Background& background) {
  Sample out;
  for (std::size_t e = 0; e < kElements; ++e) {
    const float amplitude = background.response[e % kFirstPhase], deviation = background.deviation[e];
    out[e] = deviation / (amplitude + deviation);
  }
  return out;
}

void write_tokens(const NetworkConfig& config, const Normalisation& normalisation,
                  const Background* background, std::span<const float> x, LinkSet links,
                  std::span<float> tokens) {
  const std::size_t numbers = tokens.size() / kSamples;  // of a sample
  assert(tokens.size() == config.token_count(links) * config.token_numbers());
  const bool told = config.background_conditioning;
  const Sample moves = told && background != nullptr ? mobility(*background) : Sample{};
  Sample before{};
  for (std::size_t t = 0; t < kSamples; ++t) {
    const Sample sample = sample_of(x, t);
    float* token = &tokens[t * numbers];
    if (t > 0 && sample == before) {  // sets that keep few samples of a window repeat them
      std::copy_n(token - numbers, numbers, token);
      continue;
    }
    const Sample given = scaled(normalisation, background, sample, links);
    for (std::size_t column = 0; column < config.token_grid().columns; ++column) {
      if (!config.has_token(column, links)) continue;
      for (std::size_t i = 0; i < config.token_links(); ++i) {
        const std::size_t link = config.token_link(column, i);
        if (!links[link]) {
          token = std::fill_n(token, config.link_numbers(), 0.f);
          continue;
        }
        for (std::size_t e = link; e < kElements; e += kLinks) *token++ = given[e];
        if (!told) continue;
        for (std::size_t e = link; e < kElements; e += kLinks) *token++ = moves[e];
      }
    }
    before = sample;
  }
}

}  // namespace csipose
