// model/background_meter.h - the background of an installation, from windows that were received there.
#pragma once

#include <array>
#include <cstdint>
#include <span>
#include <string>

#include "model/normalisation.h"

namespace csipose {

class BackgroundMeter {
 public:
  /// x: [60][20][9] as Window::x. Its middle sample is taken; the others are much like it.
  void add(std::span<const float> x);
  std::uint64_t windows() const { return count_; }
  /// Mean and deviation of the amplitudes; of the phases the direction of the mean of exp(i phase), and the deviation of a
  /// normal density wrapped around the circle whose mean is as long. Throws SetupError (bad_data) that names the element which
  /// does not vary.
  /// source: Mardia and Jupp, Directional Statistics, 2000, sections 2.3 and 3.5.7
  Background background(const std::string& name) const;

 private:
  std::uint64_t count_ = 0;
  std::array<double, kElements> first_{}, second_{};  // sums: amplitude and its square, or cosine and sine
};

}  // namespace csipose
