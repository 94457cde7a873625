// model/engine.h - a window's tensor in, the network's raw answer out. Two makers: a plain reference and oneDNN.
//
// Sizes come from the weights file (model/config.h). Everything is allocated at construction; run() of the oneDNN
// engine makes only the small allocations inside the library itself.
#pragma once

#include <memory>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "proto/window.h"

namespace csipose {

class Model;        // model/model.h: configuration, weights, metadata, digest
struct Background;  // model/normalisation.h

enum class Precision : std::uint8_t { f32, bf16, int8 };

/// Raw answer for one window, Q queries in descending order of their proposal's score (an engine that refines only some
/// of them gives those, in the same order). Views live until the next run.
struct NetworkOutput {
  std::span<const float> logits;   ///< [Q] class logit of the last decoder layer
  std::span<const float> poses;    ///< [Q][14][3] refined joints, label frame of the model, metres
  std::span<const float> sigma_m;  ///< [Q][14] expected error, metres; empty when the model has no such head
};

class Engine {
 public:
  virtual ~Engine() = default;
  /// x: [60][20][9] as Window::x, not normalised. `links` are encoded, the others are left out of the sequence; at least
  /// one must be set. `background` is the installation's, one of the model's; nullptr: the nearest to this window alone, where the
  /// model has any. Same input, same bits, for one engine, precision and thread count.
  NetworkOutput run(std::span<const float> x, LinkSet links, const Background* background = nullptr) {
    return infer(x, links, background);
  }
  /// Output of a named stage of the last run ("embed", "block0" .., "encoder", "memory", "enc_cls", "enc_kpt", "topk",
  /// "layer0" .., "cls", "kpt", "refined"), for comparisons; empty when this engine does not keep it.
  virtual std::span<const float> stage(const std::string& name) const = 0;
  virtual Precision precision() const = 0;
  /// "oneDNN 2.6.3, bf16 (brg:avx512_core_bf16), 2 threads".
  virtual std::string describe() const = 0;
  /// What was decided at start and why, with measured times: for the log, never for frames.
  virtual std::string notes() const { return {}; }

 private:
  virtual NetworkOutput infer(std::span<const float> x, LinkSet links, const Background* background) = 0;
};

/// Plain loops in f32, written to be read beside the specification; the oracle of all others. Slow.
std::unique_ptr<Engine> make_reference_engine(std::shared_ptr<const Model> model);

struct OneDnnOptions {
  int threads = 2;
  /// nullopt: the fastest that the processor has and the model's accuracy gate allows, timed at start.
  std::optional<Precision> precision;
  std::vector<int> cpus;  ///< processors to pin the engine's threads to; empty = not pinned
  bool keep_stages = false;
  /// Only this many queries, those with the highest logits, are refined and given; 0 = all. Refinement is a quarter of
  /// the network's arithmetic when all 100 queries of `paper` pass it, and nobody looks at the last 80.
  std::size_t refined_queries = 20;
};
/// Throws SetupError when the model or the processor cannot do what is asked.
std::unique_ptr<Engine> make_onednn_engine(std::shared_ptr<const Model> model, const OneDnnOptions& options);

}  // namespace csipose
