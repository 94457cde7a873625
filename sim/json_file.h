// sim/json_file.h - JSON that people write: every refusal names the file and the place in it, as in "scene.json: bodies[2].mat: ...".
//
// All of these throw SetupError (bad_data) when the file does not hold what is asked for.
#pragma once

#include <filesystem>
#include <initializer_list>
#include <memory>
#include <nlohmann/json_fwd.hpp>
#include <string>
#include <string_view>
#include <vector>

#include "sim/geometry.h"

namespace csipose::sim {

/// A place in the file; lives no longer than its JsonFile.
class JsonNode {
 public:
  JsonNode(const nlohmann::json& value, std::string file, std::string path)
      : value_(value), file_(std::move(file)), path_(std::move(path)) {}

  [[noreturn]] void refuse(const std::string& why) const;
  /// Is an object, and has no other keys.
  void allow_only(std::initializer_list<const char*> keys) const;
  bool has(const char* key) const;
  JsonNode at(const char* key) const;
  std::vector<JsonNode> list() const;
  /// Keys and values of an object.
  std::vector<std::pair<std::string, JsonNode>> items() const;

  bool is_text() const;
  std::string text() const;
  double number() const;
  double number_in(double low, double high) const;
  int integer_in(int low, int high) const;
  Vec3 vec3() const;
  Vec3 direction() const;

 private:
  const nlohmann::json& value_;
  std::string file_, path_;
};

class JsonFile {
 public:
  JsonFile(std::string_view text, const std::string& file_name);
  ~JsonFile();
  JsonNode root() const { return {*value_, file_name_, ""}; }

 private:
  std::unique_ptr<nlohmann::json> value_;
  std::string file_name_;
};

/// All of a file; SetupError (no_input) when it cannot be read. `what` it is: "scene".
std::string read_text_file(const std::filesystem::path& file, const char* what);

}  // namespace csipose::sim
