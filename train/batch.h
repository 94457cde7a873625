// train/batch.h - windows and labels of data sets as tensors: pooled, held out by clip, scaled by corpus, shuffled by seed.
#pragma once

#include <cstdint>
#include <memory>
#include <span>
#include <string>
#include <vector>

#include "model/model.h"
#include "train/losses.h"
#include "train/masks.h"
#include "train/torch.h"
#include "train/window_source.h"

namespace csipose::train {

/// What windows are scaled by (model/normalisation.h): three scalars of each set, the same for all sets, or the backgrounds
/// of the installations that the sets name.
enum class ScaledBy { set, all, background };
/// As data.norm names them.
ScaledBy scaled_by(const std::string& norm);

/// For each window of a batch, the windows whose people are added to it.
using Added = std::vector<std::vector<std::uint64_t>>;

/// Several data sets as one, each with its own scaling.
class Pool {
 public:
  explicit Pool(std::vector<std::shared_ptr<const WindowSource>> sources);

  std::size_t size() const { return first_.back(); }
  /// A line for people and for metadata: "sim-object (90000), piw3d (85000)".
  std::string describe() const;
  void read(std::size_t i, std::span<float> x) const;
  std::span<const Skeleton> people(std::size_t i) const;
  /// Throws SetupError (bad_config): a source keeps fewer samples of its windows than `wanted`; `what` asks for them.
  void require_samples(std::size_t wanted, std::string_view what) const;
  /// Distinct for clips of different sources.
  std::uint64_t clip(std::size_t i) const;
  /// Name of the window's installation.
  std::string installation(std::size_t i) const;

  /// Measures on those of the sources' windows that `windows` names. Throws SetupError (bad_data): numbers that do not vary.
  void measure_scaling(std::span<const std::uint64_t> windows, ScaledBy by = ScaledBy::set);
  /// The same for all sources: that with which a network was trained.
  void set_scaling(const Normalisation& scaling) { scaling_.assign(sources_.size(), scaling); }
  const std::vector<Normalisation>& scaling() const { return scaling_; }

  /// Where the tensors below are given; the CPU at first.
  void give_on(const at::Device& device) { device_ = device; }
  /// Tokens as a network of `config` takes them; of 60 numbers, one for each sample and link, at first. Throws SetupError (bad_config): it is told of backgrounds,
  /// and there are none.
  void give_for(const NetworkConfig& config);
  /// Tokens (windows, as the grid, NetworkConfig::token_numbers()), scaled; against the background of the installation that the set names, where it is known.
  /// To those of each window, the departures of the windows added[b] are added, all of the same installation: what its channel would
  /// be with the people of all of them, but for their shadows on each other. `added` may be empty; not of flat tokens.
  at::Tensor tokens(std::span<const std::uint64_t> windows, const Added& added = {}) const;
  People people_of(std::span<const std::uint64_t> windows, const Added& added = {}) const;

 private:
  std::pair<std::size_t, std::size_t> locate(std::size_t i) const;
  void write_tokens_of(std::uint64_t window, std::span<float> tokens) const;
  void add_departures(std::uint64_t window, std::span<float> tokens) const;

  std::vector<std::shared_ptr<const WindowSource>> sources_;
  std::vector<std::size_t> first_;  // of each source, and the end
  std::vector<Normalisation> scaling_;
  at::Device device_ = at::kCPU;
  NetworkConfig given_;  // of the tokens, before they are made flat
  bool flat_ = false;
};

struct Split {
  std::vector<std::uint64_t> train, held_out;
};
/// Whole clips, `share` of them (at least one when share > 0 and there are two), chosen by `seed`.
Split split_by_clip(const Pool& pool, double share, std::uint64_t seed);

/// `count` of them, evenly spread from the first on; all when count is 0 or there are no more.
std::vector<std::uint64_t> spread(const std::vector<std::uint64_t>& windows, std::size_t count);

/// The windows in the order of an epoch.
std::vector<std::uint64_t> shuffled(std::vector<std::uint64_t> windows, std::uint64_t seed,
                                    std::uint64_t epoch);

}  // namespace csipose::train
