#include "sim/json_file.h"

#include <fmt/core.h>
#include <fmt/ranges.h>

#include <algorithm>
#include <cmath>
#include <fstream>
#include <nlohmann/json.hpp>

#include "proto/result.h"

namespace csipose::sim {
using nlohmann::json;

void JsonNode::refuse(const std::string& why) const {
  throw SetupError(ExitStatus::bad_data, path_.empty() ? fmt::format("{}: {}", file_, why)
                                                       : fmt::format("{}: {}: {}", file_, path_, why));
}

void JsonNode::allow_only(std::initializer_list<const char*> keys) const {
  if (!value_.is_object()) refuse("must be an object { ... }");
  for (const auto& item : value_.items())
    if (std::find(keys.begin(), keys.end(), item.key()) == keys.end())
      refuse(fmt::format("has no key '{}'; it may have {}", item.key(), fmt::join(keys, ", ")));
}

bool JsonNode::has(const char* key) const { return value_.contains(key); }

JsonNode JsonNode::at(const char* key) const {
  if (!has(key)) refuse(fmt::format("lacks '{}'", key));
  return {value_[key], file_, path_.empty() ? key : path_ + "." + key};
}

std::vector<JsonNode> JsonNode::list() const {
  if (!value_.is_array()) refuse("must be a list [ ... ]");
  std::vector<JsonNode> nodes;
  for (std::size_t i = 0; i < value_.size(); ++i)
    nodes.emplace_back(value_[i], file_, fmt::format("{}[{}]", path_, i));
  return nodes;
}

std::vector<std::pair<std::string, JsonNode>> JsonNode::items() const {
  if (!value_.is_object()) refuse("must be an object { ... }");
  std::vector<std::pair<std::string, JsonNode>> found;
  for (const auto& item : value_.items()) found.emplace_back(item.key(), at(item.key().c_str()));
  return found;
}

bool JsonNode::is_text() const { return value_.is_string(); }

std::string JsonNode::text() const {
  if (!is_text()) refuse("must be a name in quotes");
  return value_.get<std::string>();
}

double JsonNode::number() const {
  if (!value_.is_number() || !std::isfinite(value_.get<double>())) refuse("must be a number");
  return value_.get<double>();
}

double JsonNode::number_in(double low, double high) const {
  const double x = number();
  if (x < low || x > high) refuse(fmt::format("is {}; it must lie in {} .. {}", x, low, high));
  return x;
}

int JsonNode::integer_in(int low, int high) const {
  if (!value_.is_number_integer()) refuse("must be a whole number");
  return static_cast<int>(number_in(low, high));
}

Vec3 JsonNode::vec3() const {
  const auto numbers = list();
  if (numbers.size() != 3) refuse("must have three numbers");
  return {numbers[0].number(), numbers[1].number(), numbers[2].number()};
}

Vec3 JsonNode::direction() const {
  const Vec3 v = vec3();
  if (glm::length(v) < 1e-9) refuse("must not be zero: it is a direction");
  return glm::normalize(v);
}

JsonFile::JsonFile(std::string_view text, const std::string& file_name)
    : value_(std::make_unique<json>(json::parse(text, nullptr, /*allow_exceptions=*/false))),
      file_name_(file_name) {
  if (value_->is_discarded())
    throw SetupError(ExitStatus::bad_data,
                     fmt::format("{}: is not JSON; look for a missing comma or bracket", file_name));
}

JsonFile::~JsonFile() = default;

std::string read_text_file(const std::filesystem::path& file, const char* what) {
  std::ifstream in(file, std::ios::binary);
  std::string text{std::istreambuf_iterator<char>(in), {}};
  if (!in)
    throw SetupError(ExitStatus::no_input,
                     fmt::format("cannot read the {} {}; is the name right?", what, file.string()));
  return text;
}

}  // namespace csipose::sim
