// model/calibrate.h - static int8 scales for a model, and what lower precisions cost in accuracy.
//
// The float32 network runs on the given windows, all links present, and the largest magnitude at the input of
// each linear of the encoder is noted. With these, bf16 and int8 run on the same windows and are compared
// with float32 (model/accuracy_gate.h). Both go into a copy of the weights file; the automatic choice of
// precision reads them.
#pragma once

#include <filesystem>
#include <map>
#include <memory>
#include <span>
#include <string>

#include "model/accuracy_gate.h"
#include "model/model.h"

namespace csipose {

struct Int8Calibration {
  std::map<std::string, float> input_max;  ///< by layer name: Calibration::int8_input_max
};

/// At least one window; they should be like those of later use, a few hundred are plenty.
Int8Calibration calibrate_int8(std::shared_ptr<const Model> model, std::span<const WindowTensor> windows,
                               int threads);

/// Figures of every precision that this processor has, by name, for a model that carries int8 scales.
std::map<std::string, GateFigures> measure_precisions(std::shared_ptr<const Model> model,
                                                      std::span<const WindowTensor> windows, int threads);

/// Bytes of `file` with scales and figures measured on `windows`.
std::vector<std::uint8_t> calibrate_file(const SafetensorsFile& file, std::span<const WindowTensor> windows,
                                         int threads);

}  // namespace csipose
