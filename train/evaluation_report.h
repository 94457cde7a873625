// train/evaluation_report.h - an evaluation as tables for people and as JSON for programs (docs/evaluation.md has the keys).
#pragma once

#include <nlohmann/json.hpp>
#include <string>
#include <vector>

#include "train/evaluation.h"

namespace csipose::train {

/// What the model was asked, and its figures. The first row of a report is the model with all links.
struct NamedFigures {
  std::string name;
  Evaluation figures;
};

/// On standard output; at least one row, and the trivial answers of evaluate_trivial().
void print_tables(const std::vector<NamedFigures>& rows, const std::vector<TrivialFigures>& trivial);

/// {"model": {"piw3d": {..}, "detect": {..}, ..}, "mean_at_root": {"assigned": {..}, "detect": {..}}, ..}
nlohmann::ordered_json results_json(const std::vector<NamedFigures>& rows,
                                    const std::vector<TrivialFigures>& trivial);

}  // namespace csipose::train
