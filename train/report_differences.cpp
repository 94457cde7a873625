#include "train/report_differences.h"

#include <fmt/format.h>

#include <cmath>

namespace csipose::train {
namespace {

using nlohmann::json;

void compare(const json& expected, const json& found, double most_off, const std::string& where,
             std::vector<std::string>& differences) {
  if (expected.is_structured() && found.type() == expected.type()) {
    for (const auto& [key, value] : expected.items()) {
      const json* other = nullptr;
      if (expected.is_object() && found.contains(key)) other = &found[key];
      if (expected.is_array() && std::stoul(key) < found.size()) other = &found[std::stoul(key)];
      if (other == nullptr)
        differences.push_back(fmt::format("{}/{} is missing", where, key));
      else
        compare(value, *other, most_off, where + "/" + key, differences);
    }
    return;
  }
  const bool numbers = expected.is_number() && found.is_number();
  const bool same = numbers ? std::fabs(found.get<double>() - expected.get<double>()) <=
                                  most_off * std::max(1., std::fabs(expected.get<double>()))
                            : expected == found;
  if (!same) differences.push_back(fmt::format("{} is {}, not {}", where, found.dump(), expected.dump()));
}

}  // namespace

std::vector<std::string> report_differences(const json& expected, const json& found, double most_off) {
  std::vector<std::string> differences;
  for (const char* part : {"sha256", "results"})
    compare(expected.value(part, json()), found.value(part, json()), most_off, part, differences);
  if (!expected.contains("results")) differences.push_back("no results are expected: that is no report");
  return differences;
}

}  // namespace csipose::train
