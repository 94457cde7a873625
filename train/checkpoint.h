// train/checkpoint.h - weights files that training reads and writes, and the checkpoints of a run in its folder.
//
// A checkpoint is two files, step-N.safetensors (a weights file like any other) and step-N.optim.safetensors (the
// optimiser's moments). Each appears whole; the weights come last, so that where they are the other is too. Older
// checkpoints go once a newer one is whole.
#pragma once

#include <cstdint>
#include <filesystem>
#include <map>
#include <optional>
#include <string>

#include "model/model.h"
#include "proto/file_descriptor.h"
#include "train/parameters.h"

namespace csipose::train {

struct Weights {
  NetworkConfig config;
  std::map<std::string, std::string> metadata;  ///< docs/weights.md
  Parameters parameters;                        ///< the network, norm.*, and what else the file has
};

Weights untrained_weights(const NetworkConfig& config, std::uint64_t seed);
/// A whole weights file; refused with words like everywhere (model/model.h).
Weights read_weights(const std::filesystem::path& path);
/// Sealed, in one step. Throws SetupError (cannot_create, io).
void write_weights(const std::filesystem::path& path, const Weights& weights);

/// norm.amp_mean, norm.amp_std, norm.ph_std; norm.background_response and norm.background_deviation with the metadata's "backgrounds".
void set_normalisation(Weights& weights, const Normalisation& scaling);

struct Checkpoint {
  std::uint64_t step = 0;
  Weights weights;
  Parameters optimiser;
};

class CheckpointFolder {
 public:
  /// Makes the folder. Throws SetupError (cannot_create).
  explicit CheckpointFolder(std::filesystem::path folder);
  /// From now on and until this object is gone no other process or object may claim it: two runs would take each other's
  /// checkpoints away. By an advisory lock on the file `lock`, which goes with the process that holds it, however that ends.
  /// Throws SetupError (try_again: somebody else has it; cannot_create).
  void claim();
  void write(std::uint64_t step, const Weights& weights, const Parameters& optimiser) const;
  /// The newest whole one.
  std::optional<Checkpoint> newest() const;
  const std::filesystem::path& path() const { return folder_; }

 private:
  std::filesystem::path folder_;
  FileDescriptor lock_;
};

}  // namespace csipose::train
