// train/finetune.h - from windows with labels to people: decoder, heads and encoder learn together, then the head for the
// expected error alone.
//
// Recipe: AdamW, the encoder slower than the rest, clipped gradients (aiotgroup/Person-in-WiFi-3D-repo and the WiFi-JEPA
// paper). Ours: batches whose windows lack receivers or links, so that a dead receiver is survivable; the best epoch by
// clips that were held out.
#pragma once

#include "train/loop.h"

namespace csipose::train {

/// Trains by settings.finetune. Writes `run.out`/best.safetensors (least error on the held-out clips; with the head for
/// the expected error where there is one) and last.safetensors. Goes on from a checkpoint in `run.out`.
Outcome finetune(const RunSettings& settings, Pool& pool, const Workers& workers);

/// Error of the network on windows of the pool by the protocol piw3d: mean joint distance of the nearest of all queries,
/// greedily, persons within a window first, then windows. Metres; NaN when no window has people.
double oracle_error_m(const Parameters& weights, const NetworkConfig& config, const Pool& pool,
                      std::span<const std::uint64_t> windows, const Numerics& numerics);

/// finetune.overlay: the windows, of `from`, whose people are added to each of a batch. Drawn by epoch and window alone.
Added added_people(const RunSettings& settings, const Pool& pool, std::span<const std::uint64_t> from,
                   const Moment& now, std::span<const std::uint64_t> windows);

/// What remains of each window when samples are left out, and receivers or links fail.
struct Survivors {
  /// (windows, n): a batch loses as many in each window, in each others. Undefined when all remain.
  at::Tensor tokens;
  /// (windows, 9), 0 for a link that is missing in the tokens that have several; undefined where tokens tell it all.
  at::Tensor links;
};
Survivors surviving_tokens(const RunSettings& settings, const Moment& now,
                           std::span<const std::uint64_t> windows);
/// Of tokens (B, as the grid, several links each) the numbers of those links become 0 that `links`, Survivors's, lacks.
void silence(at::Tensor& tokens, const NetworkConfig& config, const at::Tensor& links);

}  // namespace csipose::train
