// train/losses.h - what training makes small: pre-training's prediction error; fine-tuning's set loss, with the
// assignment of queries to people behind it.
//
// Costs, focal loss and weights follow aiotgroup/Person-in-WiFi-3D-repo (petr_wifi.py). Sizes as in network.h; M is the
// largest number of people in a window of the batch.
#pragma once

#include <cstdint>
#include <vector>

#include "train/network.h"

namespace csipose::train {

/// Labels of a batch: the first people[b] of poses[b] are there, the rest is padding.
struct People {
  at::Tensor poses;  ///< (B, M, 42), metres; M may be 0
  std::vector<std::int64_t> count;
};

/// Pairs of query and person, window by window; the three lists have one entry a pair.
struct Matches {
  std::vector<std::int64_t> window, query, person;
  std::size_t size() const { return window.size(); }
};

/// What is summed over the joints of a matched pose: the square of a joint's distance, as published, or the distance, which is
/// what the figures report; far-off people then pull less.
enum class PoseError { squared, distance };

struct SetLossWeights {
  double cls = 4, kpt = 70, refine = 70;
  PoseError error = PoseError::squared;
  /// Weight of the same errors as seen from each pose's own root: how somebody stands, wherever.
  double root_relative = 0;
};

/// Costs (B, Q, M) of giving person m to query q: focal class cost plus 70 |pose - label| / 28.
at::Tensor matching_cost(const at::Tensor& cls, const at::Tensor& kpt, const at::Tensor& poses,
                         const SetLossWeights& weights);
/// The assignment of least cost, window by window, in float64 on the CPU. Throws std::runtime_error when a cost is not
/// finite.
Matches match(const at::Tensor& cls, const at::Tensor& kpt, const People& people,
              const SetLossWeights& weights);

/// Sigmoid focal loss (alpha 0.25, gamma 2) over all queries (B, Q, 1), summed.
at::Tensor focal_sum(const at::Tensor& cls, const Matches& matches);
/// Error of the matched rows of kpt (B, Q, 42), summed over their joints, as weights.error has it; and
/// weights.root_relative times the same after both poses were moved to have their roots (roots_of) at the origin.
at::Tensor pose_error_sum(const at::Tensor& kpt, const Matches& matches, const People& people,
                          const SetLossWeights& weights);

/// The loss of a batch and its parts, each weighted.
struct SetLoss {
  at::Tensor total, cls, kpt, refine;
  Matches last;  ///< matches of the last decoder layer
};
/// Losses of every decoder layer, the proposals and the refinement, which corrects the last layer's matches. `matched`:
/// people whom the batch's sums are divided by; with several processes the mean of theirs, so that the gradients' mean is
/// that of the whole batch.
SetLoss set_loss(const Parameters& parameters, const DecoderShape& shape, const Decoded& decoded,
                 const People& people, const SetLossWeights& weights, const Numerics& numerics,
                 double matched);

/// A second, plainer answer that teaches the encoder: from the mean of its tokens, `features` (B, N, D), the poses of up to
/// three people in the order of their roots along axis 0, and who of the three is there. Matched queries tell the encoder
/// little at first, for a few constant poses spread over the room are near everybody; here nothing but the people's places
/// lowers the loss. predictor.ordered.*: not part of what ships.
at::Tensor ordered_loss(const Parameters& parameters, const at::Tensor& features, const People& people,
                        const SetLossWeights& weights, double matched);

/// The floor in square cells: where a root may be. Its sides are whole metres, so that sets of the same rooms share it.
struct FloorGrid {
  std::int64_t axis_x = 0, axis_y = 1;  ///< the two axes of the label frame along which roots are spread most
  double least_x_m = 0, least_y_m = 0;
  std::int64_t columns = 0, rows = 0;  ///< of kCell_m
  static constexpr double kCell_m = 0.25;
  /// Around these roots (n, 3), n > 0, with a margin.
  static FloorGrid around(const at::Tensor& roots);
  std::int64_t cells() const { return columns * rows; }
  /// Middles of the cells, (cells, 2).
  at::Tensor middles() const;
};
/// Middle of the hips of poses (.., 42): (.., 3).
at::Tensor roots_of(const at::Tensor& poses);

/// A third answer, for the encoder too: on which cells of the floor somebody is, from `features` (B, N, D); binary cross entropy
/// summed over the cells, mean over the windows. What is wanted falls off around each root like a normal density. It asks for no
/// order of the people, and one who may be here or there can be said to be: a regressed place would be between.
/// predictor.map.*: not part of what ships.
at::Tensor map_loss(const Parameters& parameters, const at::Tensor& features, const People& people,
                    const FloorGrid& grid);

/// Loss of the sigma head alone: mean of ln sigma + error / sigma over the joints of the last layer's matches (Laplace).
/// Nothing else learns from it.
at::Tensor sigma_loss(const Parameters& parameters, const DecoderShape& shape, const Decoded& decoded,
                      const People& people, const SetLossWeights& weights, const Numerics& numerics,
                      double matched);

/// SmoothL1 with beta 1, mean over everything.
at::Tensor prediction_loss(const at::Tensor& predicted, const at::Tensor& target);

}  // namespace csipose::train
