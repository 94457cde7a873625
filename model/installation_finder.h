// model/installation_finder.h - in which of the installations that a model knows a stream of windows is taken, and whether in any.
//
// A single window may be nearer to another installation's background than to its own: somebody close to a link makes departures
// many times the usual, and one receiver alone tells rooms apart badly. The installation does not change from window to window, so what
// windows tell adds up: the log-likelihoods of model/normalisation.h, those of ten seconds ago to the e-th part.
#pragma once

#include <span>
#include <vector>

#include "model/normalisation.h"
#include "proto/time.h"
#include "proto/window.h"

namespace csipose {

class InstallationFinder {
 public:
  /// The backgrounds must outlive the finder. None: nothing is ever found, nor unlike.
  explicit InstallationFinder(const std::vector<Background>& backgrounds);

  /// With this window, of the present links `links` and ending at `now`, and those before it: the likeliest background, and how unlike
  /// its windows are on average. Costs departures() of one sample for each background; allocates nothing.
  NearestBackground add(std::span<const float> x, LinkSet links, SteadyTime now);
  /// Forgets all windows.
  void reset();

 private:
  struct Evidence {
    double surprise = 0, unlikeness = 0;  ///< sums
  };
  const std::vector<Background>* backgrounds_;
  std::vector<Evidence> evidence_;  ///< of each background
  double weight_ = 0;               ///< of the windows in these sums
  SteadyTime last_{};
};

}  // namespace csipose
