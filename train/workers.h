// train/workers.h - the processes of a run: one, or several that share each step's batch.
//
// Each process has all weights and its own part of the batch; after the backward pass the gradients are averaged over all
// processes, so that every one makes the same step. Launched by the usual environment variables, so that torchrun, Slurm or
// a shell can: RANK, WORLD_SIZE, MASTER_ADDR, MASTER_PORT. Without WORLD_SIZE the run is alone. Transport: libtorch's c10d
// with gloo.
#pragma once

#include <memory>
#include <vector>

#include "train/torch.h"

namespace csipose::train {

class Workers {
 public:
  /// One process.
  Workers();
  /// By the environment. Throws SetupError (usage: a variable that is missing or no number; unavailable: the others
  /// cannot be reached).
  static Workers from_environment();
  ~Workers();
  Workers(Workers&&) noexcept;

  int rank() const { return rank_; }
  int size() const { return size_; }
  bool first() const { return rank_ == 0; }

  /// Replaces each tensor (float32) by its mean over the processes. The identity, and free, when there is one.
  void average(const std::vector<at::Tensor>& tensors) const;
  double average(double value) const;
  /// True when it is in any process.
  bool any(bool value) const;

 private:
  struct Group;
  int rank_ = 0, size_ = 1;
  std::unique_ptr<Group> group_;
};

}  // namespace csipose::train
