#include "train/losses.h"

#include <algorithm>
#include <cmath>
#include <numeric>
#include <stdexcept>

#include "model/assignment.h"
#include "proto/pose.h"
#include "proto/shape.h"

namespace csipose::train {
namespace {

constexpr double kAlpha = 0.25, kGamma = 2;  // focal loss
constexpr double kPoseCostDivisor = 28;      // 14 joints in two dimensions, kept from 2-D PETR
constexpr double kLogGuard = 1e-12;
constexpr double kRootGuard = 1e-6;  // m^2: a distance of 0 has no gradient

at::Tensor index_tensor(const std::vector<std::int64_t>& values, const at::Tensor& like) {
  return at::tensor(values, at::kLong).to(like.device());
}

/// Rows of x (B, n, C) by window and row.
at::Tensor rows(const at::Tensor& x, const std::vector<std::int64_t>& window,
                const std::vector<std::int64_t>& row) {
  return x.index({index_tensor(window, x), index_tensor(row, x)});
}

/// Over the joints of differences (n, 42), metres.
at::Tensor error_sum(const at::Tensor& off, PoseError error) {
  const at::Tensor squares = off.square();
  if (error == PoseError::squared) return squares.sum();
  return (squares.view({-1, static_cast<std::int64_t>(kJoints), 3}).sum(-1) + kRootGuard).sqrt().sum();
}

double class_divisor(double matched) { return std::max(matched, 1.); }
double pose_divisor(double matched) { return std::max(static_cast<double>(kPoseWidth) * matched, 1.); }

/// For each window the queries to refine, (B, P): the matched ones in the order of matches; short windows repeat query 0.
/// `slot` takes the place of each match within its window.
at::Tensor chosen_queries(const Matches& matches, std::int64_t windows, std::vector<std::int64_t>& slot) {
  std::vector<std::int64_t> used(static_cast<std::size_t>(windows), 0);
  for (const std::int64_t window : matches.window) slot.push_back(used[static_cast<std::size_t>(window)]++);
  const std::int64_t most = std::max<std::int64_t>(1, *std::max_element(used.begin(), used.end()));
  at::Tensor chosen = at::zeros({windows, most}, at::kLong);
  auto at = chosen.accessor<std::int64_t, 2>();
  for (std::size_t i = 0; i < matches.size(); ++i) at[matches.window[i]][slot[i]] = matches.query[i];
  return chosen;
}

void add_layer(SetLoss& loss, const at::Tensor& cls, const at::Tensor& kpt, const Matches& matches,
               const People& people, const SetLossWeights& weights, double matched) {
  loss.cls = loss.cls + weights.cls * focal_sum(cls, matches) / class_divisor(matched);
  loss.kpt = loss.kpt + weights.kpt * pose_error_sum(kpt, matches, people, weights) / pose_divisor(matched);
}

/// The first `there` people of poses (M, 42) by the first coordinate of their roots.
std::vector<std::int64_t> from_left_to_right(const at::Tensor& poses, std::int64_t there) {
  std::vector<std::int64_t> order(static_cast<std::size_t>(there));
  std::iota(order.begin(), order.end(), std::int64_t{0});
  const auto joint = poses.accessor<float, 2>();
  const auto root_x = [&](std::int64_t p) { return joint[p][3 * kLeftHip] + joint[p][3 * kRightHip]; };
  std::stable_sort(order.begin(), order.end(), [&](auto i, auto j) { return root_x(i) < root_x(j); });
  return order;
}

struct RefinedMatches {
  Refined refined;
  std::vector<std::int64_t> slot;  ///< of each match, within its window
};
RefinedMatches refine_matches(const Parameters& parameters, const DecoderShape& shape, const Decoded& decoded,
                              const Matches& matches, const Numerics& numerics) {
  RefinedMatches out;
  const at::Tensor chosen =
      chosen_queries(matches, decoded.memory.size(0), out.slot).to(decoded.memory.device());
  out.refined = refine(parameters, shape, decoded, chosen, numerics);
  return out;
}

}  // namespace

at::Tensor matching_cost(const at::Tensor& cls, const at::Tensor& kpt, const at::Tensor& poses,
                         const SetLossWeights& weights) {
  const at::Tensor p = at::sigmoid(cls);
  const at::Tensor is_person = kAlpha * at::pow(1 - p, kGamma) * -at::log(p + kLogGuard);
  const at::Tensor is_none = (1 - kAlpha) * at::pow(p, kGamma) * -at::log(1 - p + kLogGuard);
  const at::Tensor distance = (kpt.unsqueeze(2) - poses.unsqueeze(1)).square().sum(-1).sqrt();
  return weights.cls * (is_person - is_none) + weights.kpt / kPoseCostDivisor * distance;
}

Matches match(const at::Tensor& cls, const at::Tensor& kpt, const People& people,
              const SetLossWeights& weights) {
  Matches matches;
  if (people.poses.size(1) == 0) return matches;
  const at::Tensor all =
      matching_cost(cls.detach(), kpt.detach(), people.poses, weights).to(at::kCPU, at::kDouble).contiguous();
  const std::int64_t queries = all.size(1), padded = all.size(2);
  Assignment assignment(static_cast<std::size_t>(queries), static_cast<std::size_t>(padded));
  std::vector<double> cost;
  for (std::int64_t b = 0; b < all.size(0); ++b) {
    const std::int64_t there = people.count[static_cast<std::size_t>(b)];
    if (there == 0) continue;
    cost.clear();
    for (std::int64_t q = 0; q < queries; ++q) {
      const double* row = all.data_ptr<double>() + (b * queries + q) * padded;
      cost.insert(cost.end(), row, row + there);
    }
    if (!std::all_of(cost.begin(), cost.end(), [](double c) { return std::isfinite(c); }))
      throw std::runtime_error("the network gives numbers that are not finite");
    const auto person_of =
        assignment.solve(cost, static_cast<std::size_t>(queries), static_cast<std::size_t>(there));
    for (std::size_t q = 0; q < person_of.size(); ++q)
      if (person_of[q] != kUnassigned) {
        matches.window.push_back(b);
        matches.query.push_back(static_cast<std::int64_t>(q));
        matches.person.push_back(static_cast<std::int64_t>(person_of[q]));
      }
  }
  return matches;
}

at::Tensor focal_sum(const at::Tensor& cls, const Matches& matches) {
  at::Tensor wanted = at::zeros(cls.sizes(), cls.options());
  if (matches.size() > 0)
    wanted.index_put_({index_tensor(matches.window, cls), index_tensor(matches.query, cls)},
                      at::ones({1}, cls.options()));
  const at::Tensor p = at::sigmoid(cls);
  const at::Tensor off = (1 - p) * wanted + p * (1 - wanted);
  const at::Tensor weight = (kAlpha * wanted + (1 - kAlpha) * (1 - wanted)) * off.square();
  return (weight * at::binary_cross_entropy_with_logits(cls, wanted, {}, {}, at::Reduction::None)).sum();
}

at::Tensor pose_error_sum(const at::Tensor& kpt, const Matches& matches, const People& people,
                          const SetLossWeights& weights) {
  if (matches.size() == 0) return 0 * kpt.sum();
  const at::Tensor off =
      rows(kpt, matches.window, matches.query) - rows(people.poses, matches.window, matches.person);
  const at::Tensor sum = error_sum(off, weights.error);
  if (weights.root_relative == 0) return sum;
  const at::Tensor about_root = off - roots_of(off).repeat({1, static_cast<std::int64_t>(kJoints)});
  return sum + weights.root_relative * error_sum(about_root, weights.error);
}

SetLoss set_loss(const Parameters& parameters, const DecoderShape& shape, const Decoded& decoded,
                 const People& people, const SetLossWeights& weights, const Numerics& numerics,
                 double matched) {
  SetLoss loss;
  loss.cls = loss.kpt = loss.refine = at::zeros({}, decoded.memory.options());
  for (std::size_t i = 0; i < shape.decoder_layers; ++i) {
    loss.last = match(decoded.cls[i], decoded.kpt[i], people, weights);
    add_layer(loss, decoded.cls[i], decoded.kpt[i], loss.last, people, weights, matched);
  }
  const Matches proposals = match(decoded.enc_cls, decoded.enc_kpt, people, weights);
  add_layer(loss, decoded.enc_cls, decoded.enc_kpt, proposals, people, weights, matched);
  const double divisor = pose_divisor(matched);
  if (shape.refine_layers > 0 && loss.last.size() > 0) {
    const RefinedMatches found = refine_matches(parameters, shape, decoded, loss.last, numerics);
    const Matches placed{loss.last.window, found.slot, loss.last.person};
    for (const at::Tensor& pose : found.refined.pose)
      loss.refine = loss.refine + weights.refine * pose_error_sum(pose, placed, people, weights) / divisor;
  }
  loss.total = loss.cls + loss.kpt + loss.refine;
  return loss;
}

at::Tensor ordered_loss(const Parameters& parameters, const at::Tensor& features, const People& people,
                        const SetLossWeights& weights, double matched) {
  const auto slots = static_cast<std::int64_t>(kOrderedPeople);
  const at::Tensor hidden =
      at::relu(at::linear(features.to(at::kFloat).mean(1), parameters["predictor.ordered.0.weight"],
                          parameters["predictor.ordered.0.bias"]));
  const at::Tensor answer =
      at::linear(hidden, parameters["predictor.ordered.2.weight"], parameters["predictor.ordered.2.bias"])
          .view({features.size(0), slots, kPoseWidth + 1});
  Matches matches;  // slot by person, in their order
  const at::Tensor true_poses = people.poses.to(at::kCPU);
  for (std::int64_t b = 0; b < features.size(0); ++b) {
    const auto order = from_left_to_right(true_poses[b], people.count[static_cast<std::size_t>(b)]);
    for (std::size_t s = 0; s < std::min(order.size(), kOrderedPeople); ++s) {
      matches.window.push_back(b);
      matches.query.push_back(static_cast<std::int64_t>(s));
      matches.person.push_back(order[s]);
    }
  }
  const at::Tensor logits = answer.narrow(2, kPoseWidth, 1), poses = answer.narrow(2, 0, kPoseWidth);
  return weights.cls * focal_sum(logits, matches) / class_divisor(matched) +
         weights.kpt * pose_error_sum(poses, matches, people, weights) / pose_divisor(matched);
}

FloorGrid FloorGrid::around(const at::Tensor& roots) {
  constexpr double kMargin_m = 0.3;
  const at::Tensor least = std::get<0>(roots.min(0)).to(at::kDouble),
                   most = std::get<0>(roots.max(0)).to(at::kDouble);
  const at::Tensor widest = std::get<1>((most - least).topk(2));
  const auto a = widest[0].item<std::int64_t>(), b = widest[1].item<std::int64_t>();
  FloorGrid grid;
  grid.axis_x = std::min(a, b);
  grid.axis_y = std::max(a, b);
  const auto side = [&](std::int64_t axis, double& from) {
    from = std::floor(least[axis].item<double>() - kMargin_m);
    return static_cast<std::int64_t>(
        std::lround((std::ceil(most[axis].item<double>() + kMargin_m) - from) / kCell_m));
  };
  grid.columns = side(grid.axis_x, grid.least_x_m);
  grid.rows = side(grid.axis_y, grid.least_y_m);
  return grid;
}

at::Tensor FloorGrid::middles() const {
  const at::Tensor x = (at::arange(columns, at::kFloat) + 0.5) * kCell_m + least_x_m;
  const at::Tensor y = (at::arange(rows, at::kFloat) + 0.5) * kCell_m + least_y_m;
  return at::stack({x.repeat_interleave(rows), y.repeat({columns})}, 1);
}

at::Tensor roots_of(const at::Tensor& poses) {
  return (poses.narrow(-1, 3 * static_cast<std::int64_t>(kLeftHip), 3) +
          poses.narrow(-1, 3 * static_cast<std::int64_t>(kRightHip), 3)) /
         2;
}

at::Tensor map_loss(const Parameters& parameters, const at::Tensor& features, const People& people,
                    const FloorGrid& grid) {
  constexpr double kReach_m = 0.25;  // deviation of what is wanted
  // Each token says what it holds for possible before they are put together.
  const at::Tensor evidence =
      at::relu(at::linear(features.to(at::kFloat), parameters["predictor.map.0.weight"],
                          parameters["predictor.map.0.bias"]))
          .mean(1);
  const at::Tensor logits =
      at::linear(evidence, parameters["predictor.map.2.weight"], parameters["predictor.map.2.bias"]);
  const at::Tensor roots = roots_of(people.poses);  // (B, P, 3)
  const at::Tensor floor = at::stack({roots.select(-1, grid.axis_x), roots.select(-1, grid.axis_y)}, -1);
  const at::Tensor squares = (floor.unsqueeze(2) - grid.middles().to(floor.device())).square().sum(-1);
  const at::Tensor there = at::arange(floor.size(1)).unsqueeze(0) < at::tensor(people.count).unsqueeze(1);
  const at::Tensor near = at::exp(squares / (-2 * kReach_m * kReach_m)) *
                          there.to(floor.options()).unsqueeze(-1);  // (B, P, cells)
  const at::Tensor wanted = floor.size(1) > 0 ? std::get<0>(near.max(1)) : at::zeros_like(logits);
  return at::binary_cross_entropy_with_logits(logits, wanted, {}, {}, at::Reduction::None).sum() /
         static_cast<double>(features.size(0));
}

at::Tensor sigma_loss(const Parameters& parameters, const DecoderShape& shape, const Decoded& decoded,
                      const People& people, const SetLossWeights& weights, const Numerics& numerics,
                      double matched) {
  const Matches matches = match(decoded.cls.back(), decoded.kpt.back(), people, weights);
  const double divisor = std::max(1., static_cast<double>(kJoints) * matched);
  const RefinedMatches found = refine_matches(parameters, shape, decoded, matches, numerics);
  const at::Tensor sigma_m = joint_sigma_m(parameters, found.refined.state.detach());
  if (matches.size() == 0) return 0 * sigma_m.sum();
  const at::Tensor off = rows(found.refined.pose.back(), matches.window, found.slot) -
                         rows(people.poses, matches.window, matches.person);
  const at::Tensor error_m = off.detach().view({-1, static_cast<std::int64_t>(kJoints), 3}).norm(2, -1);
  const at::Tensor sigma = rows(sigma_m, matches.window, found.slot);
  return (at::log(sigma) + error_m / sigma).sum() / divisor;
}

at::Tensor prediction_loss(const at::Tensor& predicted, const at::Tensor& target) {
  return at::smooth_l1_loss(predicted, target);
}

}  // namespace csipose::train
