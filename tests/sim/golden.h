// tests/sim/golden.h - golden values of the simulator: JSON with complex arrays as {"re": [...], "im":
// [...]}.
#pragma once

#include <complex>
#include <fstream>
#include <nlohmann/json.hpp>
#include <vector>

#include "tests/shared_data.h"

namespace csipose::testing {

inline nlohmann::json golden(const std::string& name) {
  std::ifstream in(shared_data("sim/" + name));
  return nlohmann::json::parse(in);
}

/// One list of a file, by value: a loop may run over what this returns.
inline std::vector<nlohmann::json> golden_list(const std::string& name, const std::string& list) {
  return golden(name).at(list).get<std::vector<nlohmann::json>>();
}

/// A number as JSON has it: {"re", "im"} of numbers.
inline std::complex<double> complex_number(const nlohmann::json& j) {
  return {j.at("re").get<double>(), j.at("im").get<double>()};
}
/// {"re", "im"} of equally long lists.
inline std::vector<std::complex<double>> complex_list(const nlohmann::json& j) {
  const auto re = j.at("re").get<std::vector<double>>(), im = j.at("im").get<std::vector<double>>();
  std::vector<std::complex<double>> list;
  for (std::size_t i = 0; i < re.size(); ++i) list.emplace_back(re[i], im[i]);
  return list;
}

}  // namespace csipose::testing
