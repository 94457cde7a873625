#include "train/reliability.h"

#include <algorithm>
#include <cassert>
#include <cmath>

namespace csipose::train {
namespace {

constexpr int kMostSteps = 100;
constexpr double kFlat = 1e-9;    // of the gradient, per verdict
constexpr double kRidge = 1e-12;  // keeps the Hessian invertible, as in the paper

double sigmoid(double z) { return 1 / (1 + std::exp(-z)); }
/// log(1 + exp(z)) that neither overflows nor loses small numbers.
double softplus(double z) { return std::max(z, 0.0) + std::log1p(std::exp(-std::abs(z))); }

/// Negative log-likelihood of targets under sigmoid(a u + b), and the way down from there.
class Likelihood {
 public:
  Likelihood(std::vector<double> u, std::vector<double> target)
      : u_(std::move(u)), target_(std::move(target)) {}

  double loss(double a, double b) const {
    double sum = 0;
    for (std::size_t i = 0; i < u_.size(); ++i) {
      const double z = a * u_[i] + b;
      sum += softplus(z) - target_[i] * z;
    }
    return sum;
  }

  struct Step {
    double a = 0, b = 0;
    double slope = 0;  ///< of the loss along it, below zero
    bool flat = false;
  };
  Step newton(double a, double b) const {
    double ga = 0, gb = 0, haa = kRidge, hab = 0, hbb = kRidge;
    for (std::size_t i = 0; i < u_.size(); ++i) {
      const double p = sigmoid(a * u_[i] + b), w = p * (1 - p);
      ga += (p - target_[i]) * u_[i], gb += p - target_[i];
      haa += w * u_[i] * u_[i], hab += w * u_[i], hbb += w;
    }
    const double determinant = haa * hbb - hab * hab;
    Step step{-(hbb * ga - hab * gb) / determinant, -(haa * gb - hab * ga) / determinant};
    step.slope = ga * step.a + gb * step.b;
    step.flat = std::max(std::abs(ga), std::abs(gb)) < kFlat * static_cast<double>(u_.size());
    return step;
  }

 private:
  std::vector<double> u_, target_;
};

}  // namespace

void Reliability::add(double said, bool came_true) {
  const auto last = static_cast<double>(bins_.size() - 1);
  const double place = std::floor(said * static_cast<double>(bins_.size()));
  Bin& bin = bins_[static_cast<std::size_t>(std::clamp(place, 0.0, last))];
  ++bin.count;
  bin.came_true += came_true;
  bin.said += said;
}

std::size_t Reliability::count() const {
  std::size_t count = 0;
  for (const Bin& bin : bins_) count += bin.count;
  return count;
}

double Reliability::expected_error() const {
  double sum = 0;
  for (const Bin& bin : bins_) sum += std::abs(bin.said - static_cast<double>(bin.came_true));
  return sum / static_cast<double>(count());
}

std::optional<PlattScaling> fit_platt(std::span<const Verdict> verdicts) {
  const auto differs = [&](const Verdict& verdict) { return verdict.said != verdicts.front().said; };
  if (std::none_of(verdicts.begin(), verdicts.end(), differs)) return std::nullopt;
  const auto all = static_cast<double>(verdicts.size());
  double mean = 0, square = 0, came_true = 0;
  for (const Verdict& verdict : verdicts) {
    mean += verdict.said / all;
    came_true += verdict.came_true;
  }
  for (const Verdict& verdict : verdicts) square += (verdict.said - mean) * (verdict.said - mean) / all;
  const double spread = std::sqrt(square), did_not = all - came_true;
  std::vector<double> u, target;  // u: standardised, so that the Hessian is well-conditioned
  for (const Verdict& verdict : verdicts) {
    u.push_back((verdict.said - mean) / spread);
    target.push_back(verdict.came_true ? (came_true + 1) / (came_true + 2) : 1 / (did_not + 2));
  }
  const Likelihood likelihood(std::move(u), std::move(target));
  double a = 0, b = std::log((came_true + 1) / (did_not + 1));
  for (int i = 0; i < kMostSteps; ++i) {
    const Likelihood::Step step = likelihood.newton(a, b);
    if (step.flat) break;
    const double before = likelihood.loss(a, b);
    double part = 1;
    while (part > 1e-10 &&
           likelihood.loss(a + part * step.a, b + part * step.b) > before + 1e-4 * part * step.slope)
      part /= 2;
    a += part * step.a, b += part * step.b;
  }
  const auto slope = static_cast<float>(a / spread);
  if (!(slope > 0)) return std::nullopt;
  return PlattScaling{slope, static_cast<float>(b - a * mean / spread)};
}

std::vector<double> pool_adjacent_violators(std::span<const double> values, std::span<const double> weights) {
  assert(values.size() == weights.size());
  struct Pool {
    double mean, weight;
    std::size_t members;
  };
  std::vector<Pool> pools;
  for (std::size_t i = 0; i < values.size(); ++i) {
    Pool pool{values[i], weights[i], 1};
    while (!pools.empty() && pools.back().mean >= pool.mean) {
      const Pool& low = pools.back();
      const double weight = low.weight + pool.weight;
      pool = {(low.weight * low.mean + pool.weight * pool.mean) / weight, weight, low.members + pool.members};
      pools.pop_back();
    }
    pools.push_back(pool);
  }
  std::vector<double> fitted;
  for (const Pool& pool : pools) fitted.insert(fitted.end(), pool.members, pool.mean);
  return fitted;
}

ConfidenceCurve fit_curve(std::vector<Verdict> verdicts) {
  assert(!verdicts.empty());
  std::sort(verdicts.begin(), verdicts.end(),
            [](const Verdict& a, const Verdict& b) { return a.said < b.said; });
  std::vector<double> said, share, weight;
  for (std::size_t from = 0, knot = 1; from < verdicts.size(); ++knot) {
    std::size_t to = std::max(from + 1, knot * verdicts.size() / kConfidenceKnots);
    while (to < verdicts.size() && verdicts[to].said == verdicts[to - 1].said) ++to;
    double sum = 0, came_true = 0;
    for (std::size_t i = from; i < to; ++i) sum += verdicts[i].said, came_true += verdicts[i].came_true;
    weight.push_back(static_cast<double>(to - from));
    said.push_back(sum / weight.back());
    share.push_back(came_true / weight.back());
    from = to;
  }
  const std::vector<double> fitted = pool_adjacent_violators(share, weight);
  ConfidenceCurve curve;
  for (std::size_t i = 0; i < kConfidenceKnots; ++i) {
    const bool known = i < said.size();
    curve.raw[i] = known ? static_cast<float>(said[i]) : curve.raw[i - 1] + 1;
    curve.corrected[i] = known ? static_cast<float>(fitted[i]) : curve.corrected[i - 1];
  }
  return curve;
}

}  // namespace csipose::train
