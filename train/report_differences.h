// train/report_differences.h - whether an evaluation came out as a report of another day says.
#pragma once

#include <nlohmann/json.hpp>
#include <string>
#include <vector>

namespace csipose::train {

/// A sentence for each figure below `expected`["results"] that `found` lacks or has otherwise, and one when the weights'
/// digests differ; empty when all agree. Numbers agree within `most_off` of the expected one, or of 1 where that is less: the
/// order of additions in a matmul is the processor's business. Rows that only `found` has do not matter.
std::vector<std::string> report_differences(const nlohmann::json& expected, const nlohmann::json& found,
                                            double most_off);

}  // namespace csipose::train
