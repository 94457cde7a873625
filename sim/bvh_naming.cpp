#include "sim/bvh_naming.h"

#include <fmt/core.h>
#include <fmt/ranges.h>

#include <algorithm>
#include <cctype>

#include "proto/result.h"
#include "sim/bvh_namings_text.h"
#include "sim/json_file.h"

namespace csipose::sim {
namespace {

/// For comparison: lower case, without "mixamorig:".
std::string plain(std::string_view name) {
  const std::size_t colon = name.rfind(':');
  std::string result(colon == std::string_view::npos ? name : name.substr(colon + 1));
  for (char& c : result) c = static_cast<char>(std::tolower(static_cast<unsigned char>(c)));
  return result;
}

std::vector<std::string> names_at(const JsonNode& node) {
  if (node.is_text()) return {node.text()};
  std::vector<std::string> names;
  for (const JsonNode& name : node.list()) names.push_back(name.text());
  if (names.empty()) node.refuse("must have at least one name");
  return names;
}

Naming naming_at(const std::string& name, const JsonNode& node) {
  node.allow_only({"what", "metres_per_unit", "up", "has", "joints"});
  Naming naming;
  naming.name = name;
  if (node.has("metres_per_unit")) naming.metres_per_unit = node.at("metres_per_unit").number_in(1e-6, 1e3);
  if (node.has("up")) {
    const std::string up = node.at("up").text();
    if (up != "y" && up != "z") node.at("up").refuse(fmt::format("is '{}'; it must be y or z", up));
    naming.z_up = up == "z";
  }
  if (node.has("has")) naming.has = names_at(node.at("has"));
  for (const auto& [landmark, names] : node.at("joints").items()) {
    const auto found = std::find(kLandmarkNames.begin(), kLandmarkNames.end(), landmark);
    if (found == kLandmarkNames.end())
      names.refuse(fmt::format("is none of ours; there are {}", fmt::join(kLandmarkNames, ", ")));
    naming.joints[static_cast<std::size_t>(found - kLandmarkNames.begin())] = names_at(names);
  }
  for (std::size_t mark = 0; mark < kLandmarks; ++mark)
    if (naming.joints[mark].empty())
      node.at("joints").refuse(fmt::format("lacks '{}'", kLandmarkNames[mark]));
  return naming;
}

std::optional<std::size_t> find_joint(const BvhClip& clip, const std::string& name) {
  const std::string wanted = plain(name);
  for (std::size_t j = 0; j < clip.joints.size(); ++j)
    if (!clip.joints[j].name.empty() && plain(clip.joints[j].name) == wanted) return j;
  return std::nullopt;
}

std::optional<std::size_t> find_any(const BvhClip& clip, const std::vector<std::string>& names) {
  for (const std::string& name : names)
    if (const auto found = find_joint(clip, name)) return found;
  return std::nullopt;
}

/// Names that the file lacks.
std::vector<std::string> missing(const BvhClip& clip, const Naming& naming) {
  std::vector<std::string> lacks;
  for (const std::string& name : naming.has)
    if (!find_joint(clip, name)) lacks.push_back(name);
  for (const auto& names : naming.joints)
    if (!find_any(clip, names)) lacks.push_back(names.front());
  return lacks;
}

[[noreturn]] void refuse(const BvhClip& clip, std::span<const Naming> namings) {
  const Naming* nearest = &namings.front();
  for (const Naming& naming : namings)
    if (missing(clip, naming).size() < missing(clip, *nearest).size()) nearest = &naming;
  std::vector<std::string> there;
  for (const BvhClip::Joint& joint : clip.joints)
    if (!joint.name.empty()) there.push_back(joint.name);
  throw SetupError(
      ExitStatus::bad_data,
      fmt::format(
          "{}: no known naming of joints fits. The nearest, '{}', lacks {}. The file has {}. Give a table "
          "of your own with --bvh-joints (docs/simulator-motion.md)",
          clip.file_name, nearest->name, fmt::join(missing(clip, *nearest), ", "), fmt::join(there, ", ")));
}

}  // namespace

std::vector<Naming> parse_namings(std::string_view text, const std::string& file_name) {
  const JsonFile file(text, file_name);
  std::vector<Naming> namings;
  for (const auto& [name, node] : file.root().items()) namings.push_back(naming_at(name, node));
  if (namings.empty()) file.root().refuse("has no naming");
  return namings;
}

std::vector<Naming> read_namings(const std::filesystem::path& file) {
  return parse_namings(read_text_file(file, "table of joints"), file.string());
}

const std::vector<Naming>& built_in_namings() {
  static const std::vector<Naming> namings =
      parse_namings(kBvhNamingsText, "the table that comes with the program");
  return namings;
}

Landmarks find_landmarks(const BvhClip& clip, std::span<const Naming> namings) {
  const Naming* best = nullptr;
  for (const Naming& naming : namings)
    if (missing(clip, naming).empty() && (!best || naming.has.size() > best->has.size())) best = &naming;
  if (!best) refuse(clip, namings);
  Landmarks found{best, {}};
  for (std::size_t mark = 0; mark < kLandmarks; ++mark)
    found.joint[mark] = *find_any(clip, best->joints[mark]);
  return found;
}

}  // namespace csipose::sim
