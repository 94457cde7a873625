// model/background_meter.h - the background of an installation, from windows that were received there.
#pragma once

#include <array>
#include <cstdint>
#include <span>
#include <string>
#include <vector>

#include "model/normalisation.h"

namespace csipose {

class BackgroundMeter {
 public:
  /// x: [60][20][9] as Window::x. Its middle sample is taken; the others are much like it. Of many windows some are kept, evenly
  /// spread over all: at most 4096, 2 kB each.
  void add(std::span<const float> x);
  std::uint64_t windows() const { return count_; }
  /// The response over which those samples can be brought with the least departures, and their root mean square. Throws
  /// SetupError (bad_data) that names the element which does not vary. Costs nine times departures() of each kept sample.
  /// source: as the mean shape of generalised Procrustes analysis, Gower, Psychometrika 40, 1975, here of a line of phase and a
  /// gain for each receiver
  Background background(const std::string& name) const;

 private:
  std::uint64_t count_ = 0, stride_ = 1;  // every stride_-th is kept
  std::vector<std::array<float, kElements>> kept_;
};

}  // namespace csipose
