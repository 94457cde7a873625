// train/loop.h - the loop that all objectives share: batches, gradients over all processes, log, checkpoints, signals.
//
// An objective says what the loss of a batch is, how a step is made, and what to report at the end of an epoch. What it
// draws depends on (seed, epoch, window) and on (seed, step), never on when: a run that was stopped goes on to the same bits
// as one that was not, on the same machine with the same number of threads and processes.
#pragma once

#include <cstdint>
#include <map>
#include <span>
#include <string>
#include <utility>
#include <vector>

#include "train/adamw.h"
#include "train/batch.h"
#include "train/checkpoint.h"
#include "train/network.h"
#include "train/run_file.h"
#include "train/workers.h"

namespace csipose::train {

/// Before the first tensor: threads, an allocator that keeps what it has, no denormals.
void prepare_machine(const RunSettings& settings);

/// Named figures of a step or an epoch, in the order of their columns.
using Figures = std::vector<std::pair<std::string, double>>;

/// Where a step stands in its run.
struct Moment {
  std::uint64_t step = 0;   ///< 1-based, of the whole run
  std::uint64_t total = 0;  ///< steps of the whole run
  std::uint64_t epoch = 0;  ///< 0-based
};

class Objective {
 public:
  virtual ~Objective() = default;
  virtual AdamW& optimiser() = 0;
  /// Loss of these windows, with gradients to come; `figures` takes its parts.
  virtual at::Tensor loss(std::span<const std::uint64_t> windows, const Moment& now, Figures& figures) = 0;
  /// Makes the step with the gradients that are there; returns the learning rate.
  virtual double make_step(const Moment& now, Figures& figures) = 0;
  /// After the last step of an epoch.
  virtual void end_epoch(const Moment& now, Figures& figures) = 0;
  /// What a checkpoint holds; its metadata carry the objective's own memory.
  virtual const Weights& weights() = 0;
  /// After the last step of all: writes what the run was made for.
  virtual void finish(const Moment& now) = 0;
};

struct LoopPlan {
  std::vector<std::uint64_t>
      windows;  ///< what an epoch goes through; what is left of the last batch is dropped
  std::uint64_t epochs = 0, batch = 0;
  std::uint64_t steps_per_epoch(const Workers& workers) const;
  std::uint64_t total(const Workers& workers) const { return epochs * steps_per_epoch(workers); }
};

struct Outcome {
  std::uint64_t steps = 0;  ///< made in all, with those before a resume
  bool finished = false;  ///< false: stopped by a signal or by run.stop_after_steps; a checkpoint was written
};

/// Runs from `first_step` (0: the beginning) to the end. Throws std::runtime_error when the loss is not finite; the last
/// checkpoint stays.
Outcome run_loop(Objective& objective, const LoopPlan& plan, const RunSettings& settings,
                 const Workers& workers, const CheckpointFolder& folder, std::uint64_t first_step);

/// The checkpoint to go on from, when the folder has one. Throws SetupError (bad_config) when it was begun with other
/// settings; threads, log, checkpoint and stop may differ.
std::optional<Checkpoint> checkpoint_to_resume(const CheckpointFolder& folder, const RunSettings& settings);

/// Where this process computes. Several processes of a host take its CUDA devices in turn, by rank. Throws SetupError
/// (unavailable) when run.device is cuda and there is none.
at::Device device_of(const RunSettings& settings, const Workers& workers);

/// The type of matmul operands: as set, or as the checkpoint has it, or the faster of the two on this device.
Numerics choose_numerics(const RunSettings& settings, const std::optional<Checkpoint>& resumed,
                         const at::Device& device);

}  // namespace csipose::train
