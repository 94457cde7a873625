#include "model/json_words.h"

#include <fmt/core.h>

#include <nlohmann/json.hpp>

namespace csipose {

std::string brief(const nlohmann::json& value) {
  return value.is_structured() ? fmt::format("of type {}", value.type_name()) : value.dump();
}

}  // namespace csipose
