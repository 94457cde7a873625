// model/onednn_engine.h - the engine of engine.h on oneDNN, with what calibration and benchmarks need beyond
// it.
#pragma once

#include <memory>
#include <optional>
#include <string>

#include "model/engine.h"
#include "model/onednn_network.h"

namespace csipose {

class OneDnnEngine final : public Engine {
 public:
  /// Packs the weights and makes the primitives for every number of links (1 to 9). Throws SetupError when
  /// the precision cannot be had: no unit for it, only a reference loop in the library, or (int8) no
  /// calibration in the model.
  /// Of the options, `precision` and `keep_stages` are not looked at.
  OneDnnEngine(std::shared_ptr<const Model> model, Precision precision, const OneDnnOptions& options);

  std::span<const float> stage(const std::string& name) const override { return probe_.stage_values(name); }
  Precision precision() const override { return precision_; }
  std::string describe() const override;
  std::string notes() const override { return notes_; }

  /// Runs the encoder only: for benchmarks.
  void run_encoder(std::span<const float> x, LinkSet links);
  /// Executes every size of window that whole receivers give, so that code and data are where they will be
  /// needed.
  void warm_up();
  void add_note(const std::string& note);
  Probe& probe() { return probe_; }

 private:
  NetworkOutput infer(std::span<const float> x, LinkSet links, const Background* background) override;

  std::shared_ptr<const Model> model_;
  Precision precision_;
  OneDnnContext context_;
  OneDnnEncoder encoder_;
  OneDnnDecoder decoder_;
  Probe probe_;
  std::string notes_;
};

/// "f32", "bf16", "int8".
std::string_view name_of(Precision precision);

/// Why this processor, or this model, cannot run in a precision; nullopt when it can.
std::optional<std::string> why_not(Precision precision, const CpuFeatures& cpu, const Model& model);

}  // namespace csipose
