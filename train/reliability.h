// train/reliability.h - how far stated probabilities can be trusted, and the corrections that make them so.
//
// Sources: expected calibration error with equal bins as in Guo et al., ICML 2017; scaling by Platt 1999, its minimum by
// Newton's method as in Lin, Lin and Weng 2007; the monotone curve by pooling adjacent violators (Ayer et al. 1955).
#pragma once

#include <array>
#include <cstddef>
#include <optional>
#include <span>
#include <vector>

#include "model/model.h"

namespace csipose::train {

/// Statements of a probability, and whether they came true.
class Reliability {
 public:
  void add(double said, bool came_true);
  std::size_t count() const;
  /// Over ten bins of equal width: |mean said - share that came true|, weighted by their statements. NaN without any.
  double expected_error() const;

 private:
  struct Bin {
    std::size_t count = 0, came_true = 0;
    double said = 0;
  };
  std::array<Bin, 10> bins_{};
};

/// A number that ought to rise with the probability of what it was said of, and whether that came true.
struct Verdict {
  double said = 0;
  bool came_true = false;
};

/// sigmoid(a said + b) of greatest likelihood, with Platt's targets: (n + 1) / (n + 2) for the n that came true, and
/// 1 / (m + 2) for the m that did not, so that few verdicts make no certainty. Nothing when no rising curve fits: all
/// came true or none, all said the same, or what was said higher came true less often.
std::optional<PlattScaling> fit_platt(std::span<const Verdict> verdicts);

/// The non-descending sequence nearest to `values` by squares weighted with `weights` (as many, above zero).
std::vector<double> pool_adjacent_violators(std::span<const double> values, std::span<const double> weights);

/// Twenty groups of neighbours in what was said, as even as equal numbers allow, each a knot: mean said, and share that
/// came true after pooling. Fewer different numbers than knots: the rest lie above all. At least one verdict (assert).
ConfidenceCurve fit_curve(std::vector<Verdict> verdicts);

}  // namespace csipose::train
