#include "model/installation_finder.h"

#include <algorithm>
#include <cmath>

namespace csipose {
namespace {
constexpr double kMemory_s = 10;
}

InstallationFinder::InstallationFinder(const std::vector<Background>& backgrounds)
    : backgrounds_(&backgrounds), evidence_(backgrounds.size()) {}

NearestBackground InstallationFinder::add(std::span<const float> x, LinkSet links, SteadyTime now) {
  const double passed_s = std::chrono::duration<double>(now - last_).count();
  const double kept = std::exp(-std::clamp(passed_s, 0., 1e3) / kMemory_s);
  last_ = now;
  weight_ = weight_ * kept + 1;
  const WindowSample middle = middle_sample(x);
  std::size_t likeliest = 0;
  for (std::size_t i = 0; i < evidence_.size(); ++i) {
    const Fit fit = fit_of((*backgrounds_)[i], middle, links);
    Evidence& evidence = evidence_[i];
    evidence.surprise = evidence.surprise * kept + fit.surprise;
    evidence.unlikeness = evidence.unlikeness * kept + fit.unlikeness;
    if (evidence.surprise < evidence_[likeliest].surprise) likeliest = i;
  }
  if (evidence_.empty()) return {};
  return {&(*backgrounds_)[likeliest], evidence_[likeliest].unlikeness / weight_};
}

void InstallationFinder::reset() {
  std::fill(evidence_.begin(), evidence_.end(), Evidence{});
  weight_ = 0;
}

}  // namespace csipose
