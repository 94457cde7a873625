// train/pack.h - a trained weights file as it ships: half the size, nothing that only training needs.
#pragma once

#include <cstdint>
#include <map>
#include <string>
#include <vector>

#include "model/safetensors.h"

namespace csipose::train {

/// Bytes of `file` with every matrix and vector of the network as float16; scalars and calibration stay float32. Without
/// predictor, target encoder, and the run's memory and settings, which name folders of the machine it was trained on. `extra` adds or replaces metadata. A number beyond float16 (65504) throws
/// SetupError (bad_data): weights that large are no weights.
std::vector<std::uint8_t> pack_for_shipping(const SafetensorsFile& file,
                                            const std::map<std::string, std::string>& extra);
/// The file with the backgrounds of these installations and no others: the fewer it knows, the surer it is to see that it knows none.
/// Throws SetupError (usage): one of them is not known, and which are.
SafetensorsFile knowing_only(const SafetensorsFile& file, const std::vector<std::string>& installations);

}  // namespace csipose::train
