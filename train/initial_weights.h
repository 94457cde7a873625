// train/initial_weights.h - what a fine-tuning run begins from: random numbers, a pre-trained encoder, or all that an earlier run
// has learnt.
#pragma once

#include <cstdint>
#include <span>

#include "train/batch.h"
#include "train/checkpoint.h"
#include "train/losses.h"
#include "train/network.h"
#include "train/run_file.h"

namespace csipose::train {

/// The network that `settings` fine-tunes: network_of() and, where the run teaches it, the head for the expected error.
NetworkConfig network_of_poses(const RunSettings& settings);

/// The floor that the people of these windows walk. Throws SetupError (bad_data) when nobody is in them.
FloorGrid floor_of(const Pool& pool, std::span<const std::uint64_t> windows);

/// Weights before the first step, on the processor, with the metadata of the run. finetune.init is read where it is named.
/// Throws SetupError: bad_data when nobody is in `train`, bad_config when the file fits another network.
Weights initial_weights(const RunSettings& settings, const Pool& pool, std::span<const std::uint64_t> train,
                        const Numerics& numerics);

}  // namespace csipose::train
