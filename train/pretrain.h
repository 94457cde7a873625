// train/pretrain.h - WiFi-JEPA: an encoder that sees part of a window predicts what another, its own slow average, sees in
// the rest.
//
// source: the WiFi-JEPA paper; facebookresearch/ijepa where the paper leaves it open.
#pragma once

#include "train/loop.h"

namespace csipose::train {

/// Pre-trains by settings.pretrain on all windows of `pool` and writes `run.out`/pretrained.safetensors: context encoder as
/// encoder.*, target_encoder.*, predictor.*, and an untrained decoder. Goes on from a checkpoint in `run.out`.
Outcome pretrain(const RunSettings& settings, Pool& pool, const Workers& workers);

/// exp of the entropy of the singular values of features (n, D), each column's mean taken off: how many directions are
/// used. 1 when all rows lie on a line. source: Roy and Vetterli, "The effective rank", EUSIPCO 2007
double effective_rank(const at::Tensor& features);

}  // namespace csipose::train
