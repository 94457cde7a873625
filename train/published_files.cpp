#include "train/published_files.h"

#include <fmt/format.h>

#include <algorithm>
#include <charconv>
#include <cmath>
#include <nlohmann/json.hpp>

#include "proto/npy.h"

namespace csipose::train {
namespace {

constexpr std::string_view kBlanks = " \t\r\v\f";

/// Takes `digits` digits off the front (0: at least one, at most nine); nullopt where there are not so many.
std::optional<std::uint32_t> take_number(std::string_view& text, std::size_t digits) {
  std::size_t there = 0;
  while (there < text.size() && text[there] >= '0' && text[there] <= '9') ++there;
  if (digits == 0 ? there == 0 || there > 9 : there < digits) return std::nullopt;
  const std::size_t length = digits == 0 ? there : digits;
  std::uint32_t number = 0;
  std::from_chars(text.data(), text.data() + length, number);
  text.remove_prefix(length);
  return number;
}

bool take(std::string_view& text, char c) {
  if (!text.starts_with(c)) return false;
  text.remove_prefix(1);
  return true;
}

std::string_view first_field(std::string_view line) {
  line.remove_prefix(std::min(line.find_first_not_of(kBlanks), line.size()));
  return line.substr(0, line.find_first_of(kBlanks));
}

/// Any text on one line of a message.
std::string printable(std::string_view text) {
  constexpr std::size_t kMost = 40;
  std::string out(text.substr(0, kMost));
  for (char& c : out)
    if (c < ' ' || c > '~') c = '?';
  return text.size() > kMost ? out + "..." : out;
}

template <class T>
Result<std::vector<Skeleton>, std::string> people_in(ByteView file) {
  const Result<NpyArray<T>, std::string> array = parse_npy_as<T>(file);
  if (!array) return array.error();
  NpyShape shape = array->shape;
  if (shape.size() == 2) shape.insert(shape.begin(), 1);
  if (shape.size() != 3 || shape[0] == 0 || shape[0] > kMaxPeople || shape[1] != kJoints || shape[2] != 3)
    return fmt::format("its shape is ({}), wanted (people, 14, 3)", fmt::join(array->shape, ", "));
  std::vector<Skeleton> people(shape[0]);
  const T* next = array->data.data();
  for (Skeleton& person : people)
    for (Point3& joint : person)
      for (float* const coordinate : {&joint.x, &joint.y, &joint.z}) {
        *coordinate = static_cast<float>(*next++);
        if (!std::isfinite(*coordinate)) return std::string("it holds a number that is not finite");
      }
  return people;
}

}  // namespace

std::optional<WindowName> parse_window_name(std::string_view text) {
  WindowName name{std::string(text)};
  if (!take(text, 'S')) return std::nullopt;
  const auto scene = take_number(text, 1), people = take_number(text, 1);
  if (!scene || !people || !take(text, '_')) return std::nullopt;
  const auto clip = take_number(text, 2);
  if (!clip || !take(text, '_')) return std::nullopt;
  const auto frame = take_number(text, 0);
  if (!frame || !text.empty()) return std::nullopt;
  name.scene = *scene, name.people = *people, name.clip = *clip, name.frame = *frame;
  return name;
}

Result<NameList, std::string> parse_name_list(std::string_view text) {
  NameList list;
  bool ended = false;
  for (std::size_t line = 1; !text.empty(); ++line) {
    const std::size_t end = std::min(text.find('\n'), text.size());
    const std::string_view field = first_field(text.substr(0, end));
    text.remove_prefix(std::min(end + 1, text.size()));
    if (field.empty()) {
      ended = true;
    } else if (ended) {
      ++list.after_end;
    } else if (auto name = parse_window_name(field)) {
      list.names.push_back(std::move(*name));
    } else {
      return fmt::format("line {}: \"{}\" is no name such as S23_12_337", line, printable(field));
    }
  }
  return list;
}

Result<std::vector<Skeleton>, std::string> parse_keypoints(ByteView file) {
  const Result<NpyView, std::string> view = parse_npy(file);
  if (!view) return view.error();
  if (view->descr == kNpyType<double>) return people_in<double>(file);
  if (view->descr == kNpyType<float>) return people_in<float>(file);
  return fmt::format("its numbers are of type {}, wanted <f8 or <f4", view->descr);
}

std::map<std::uint8_t, std::string> EnvironmentMap::scenes() {
  std::map<std::uint8_t, std::string> names;
  for (std::uint8_t digit = 0; digit < 10; ++digit) names[digit] = fmt::format("scene{}", digit);
  return names;
}

Result<EnvironmentMap, std::string> EnvironmentMap::parse(std::string_view text) {
  const auto json = nlohmann::ordered_json::parse(text, nullptr, false);
  if (!json.is_object() || json.empty() || json.size() > 10)
    return std::string(R"(it is no JSON object such as {"office": ["1"], "corridor": ["2", "5"]})");
  EnvironmentMap map;
  map.names_.clear();
  for (const auto& [name, scenes] : json.items()) {
    const auto number = static_cast<std::uint8_t>(map.names_.size());
    if (name.empty() || name.front() == '.' || name.find('/') != std::string::npos)
      return fmt::format("environment \"{}\" cannot be a folder's name", printable(name));
    map.names_[number] = name;
    if (!scenes.is_array()) return fmt::format("environment \"{}\" is no list of digits", printable(name));
    for (const auto& scene : scenes) {
      const std::string digit = scene.is_string() ? scene.get<std::string>() : "";
      if (digit.size() != 1 || digit[0] < '0' || digit[0] > '9')
        return fmt::format("environment \"{}\": a scene is a digit in quotes", printable(name));
      if (!map.of_scene_.emplace(digit[0] - '0', number).second)
        return fmt::format("scene {} is in two environments", digit);
    }
  }
  return map;
}

std::optional<std::uint8_t> EnvironmentMap::of_scene(std::uint32_t scene) const {
  if (of_scene_.empty()) return static_cast<std::uint8_t>(scene);
  const auto found = of_scene_.find(scene);
  if (found == of_scene_.end()) return std::nullopt;
  return found->second;
}

}  // namespace csipose::train
