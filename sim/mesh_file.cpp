#include "sim/mesh_file.h"

#include <fmt/core.h>
#include <fmt/ranges.h>

#include <algorithm>
#include <bit>
#include <charconv>
#include <cmath>
#include <cstring>
#include <fstream>
#include <limits>
#include <optional>

#include "proto/result.h"
#include "sim/material.h"

namespace csipose::sim {
namespace {

constexpr double kSmallest_m = 0.02, kLargest_m = 200, kFarthest_m = 10'000;
constexpr std::size_t kMostFaceCorners = 1000;

[[noreturn]] void refuse(const std::string& where, const std::string& why) {
  throw SetupError(ExitStatus::bad_data, fmt::format("{}: {}", where, why));
}

std::string known_materials() {
  std::vector<std::string_view> names;
  for (const Material& material : materials()) names.push_back(material.name);
  return fmt::format("{}", fmt::join(names, ", "));
}

/// Words of a line, one after the other.
class Words {
 public:
  Words(std::string_view text, std::string where) : text_(text), where_(std::move(where)) {}
  /// Empty at the end.
  std::string_view next() {
    constexpr std::string_view kBlank = " \t\r\v\f";
    const std::size_t from = std::min(text_.find_first_not_of(kBlank), text_.size());
    const std::size_t to = std::min(text_.find_first_of(kBlank, from), text_.size());
    const std::string_view word = text_.substr(from, to - from);
    text_.remove_prefix(to);
    return word;
  }
  template <class Number>
  Number number(const char* what) {
    const std::string_view word = next();
    Number x{};
    const auto [end, error] = std::from_chars(word.data(), word.data() + word.size(), x);
    if (error != std::errc() || end != word.data() + word.size())
      refuse(where_, word.empty() ? fmt::format("ends where {} should be", what)
                                  : fmt::format("has '{}' where {} should be", word, what));
    return x;
  }
  const std::string& where() const { return where_; }

 private:
  std::string_view text_;
  std::string where_;
};

/// Lines with their numbers.
class Lines {
 public:
  Lines(std::string_view text, const std::string& file) : rest_(text), file_(file) {}
  std::optional<std::string_view> next() {
    if (rest_.empty()) return std::nullopt;
    const std::size_t end = std::min(rest_.find('\n'), rest_.size());
    std::string_view line = rest_.substr(0, end);
    rest_.remove_prefix(std::min(end + 1, rest_.size()));
    if (!line.empty() && line.back() == '\r') line.remove_suffix(1);
    ++number_;
    return line;
  }
  std::string where() const { return fmt::format("{}:{}", file_, number_); }
  std::string_view rest() const { return rest_; }

 private:
  std::string_view rest_;
  const std::string& file_;
  std::size_t number_ = 0;
};

/// Takes points and faces as they come, and judges them.
class Builder {
 public:
  Builder(const std::string& file, const MeshImport& import) : file_(file), import_(import) {}

  void add_point(const Vec3& p, const std::string& where) {
    const Vec3 scaled = import_.scale * p;
    if (!std::isfinite(scaled.x + scaled.y + scaled.z)) refuse(where, "this point is not finite");
    if (glm::length(scaled) > kFarthest_m)
      refuse(where, fmt::format("this point lies {:.0f} m from the origin; move the mesh, or say \"scale\"",
                                glm::length(scaled)));
    mesh_.points.push_back(scaled);
  }
  std::size_t points() const { return mesh_.points.size(); }

  void use_material(const std::string& name, const std::string& where) {
    if (import_.only_material && name != import_.material) return;
    const auto renamed = import_.materials.find(name);
    const std::string& ours = renamed == import_.materials.end() ? name : renamed->second;
    if (find_material(ours) == nullptr)
      refuse(where, fmt::format("there is no material '{}'; rename it, or say which it is in the scene's "
                                "\"materials\" of this mesh. There are {}",
                                ours, known_materials()));
    const auto at = std::find(mesh_.materials.begin(), mesh_.materials.end(), ours);
    material_ = static_cast<std::uint32_t>(at - mesh_.materials.begin());
    if (at == mesh_.materials.end()) mesh_.materials.push_back(ours);
  }

  /// As a fan about its first corner, which is right for convex faces only.
  void add_face(const std::vector<std::uint32_t>& corners, const std::string& where) {
    if (corners.size() < 3)
      refuse(where, fmt::format("this face has {} corners; it needs three", corners.size()));
    if (!material_) use_default_material(where);
    std::vector<Mesh::Triangle> fan;
    Vec3 whole{0};
    for (std::size_t i = 1; i + 1 < corners.size(); ++i) {
      fan.push_back({{corners[0], corners[i], corners[i + 1]}, *material_});
      whole += mesh_.area_vector(fan.back());
    }
    for (const Mesh::Triangle& t : fan)
      if (glm::dot(whole, mesh_.area_vector(t)) < 0)
        refuse(where, "this face is not convex; let the program that wrote the file triangulate its faces");
    mesh_.triangles.insert(mesh_.triangles.end(), fan.begin(), fan.end());
  }

  Mesh finish() {
    if (mesh_.triangles.empty()) refuse(file_, "has no faces; is it a cloud of points?");
    const Extent e = extent_of(mesh_);
    const Vec3 size = e.high - e.low;
    const double longest_m = std::max({size.x, size.y, size.z});
    if (longest_m > kLargest_m || longest_m < kSmallest_m)
      refuse(file_,
             fmt::format(
                 "is {:.4g} x {:.4g} x {:.4g} m: surely its unit is not the metre; say \"scale\", metres per "
                 "unit, beside it (0.001 for millimetres)",
                 size.x, size.y, size.z));
    Mesh mesh = welded(mesh_);
    if (mesh.triangles.empty()) refuse(file_, "has no face with an area");
    return mesh;
  }

 private:
  void use_default_material(const std::string& where) {
    if (import_.material.empty())
      refuse(
          where,
          fmt::format(
              "this face has no material, and the scene gives none for this mesh; say \"mat\" beside it: {}",
              known_materials()));
    use_material(import_.material, where);
  }

  const std::string& file_;
  const MeshImport& import_;
  Mesh mesh_;
  std::optional<std::uint32_t> material_;
};

/// "7", "7/1", "7//3", "-1/2/3": the point alone counts.
std::uint32_t obj_corner(std::string_view word, std::size_t points, const std::string& where) {
  const std::string_view first = word.substr(0, word.find('/'));
  long long index = 0;
  const auto [end, error] = std::from_chars(first.data(), first.data() + first.size(), index);
  if (error != std::errc() || end != first.data() + first.size())
    refuse(where, fmt::format("has '{}' where a corner should be", word));
  const long long at = index < 0 ? static_cast<long long>(points) + index : index - 1;
  if (at < 0 || at >= static_cast<long long>(points))
    refuse(where, fmt::format("names point {}, but there are {} so far", index, points));
  return static_cast<std::uint32_t>(at);
}

void read_obj_line(std::string_view line, const std::string& where, Builder& out) {
  Words words(line, where);
  const std::string_view what = words.next();
  if (what == "v") {
    const double x = words.number<double>("x"), y = words.number<double>("y"), z = words.number<double>("z");
    out.add_point({x, y, z}, where);
  } else if (what == "usemtl") {
    const std::string_view name = words.next();
    if (name.empty()) refuse(where, "ends where a material's name should be");
    out.use_material(std::string(name), where);
  } else if (what == "f") {
    std::vector<std::uint32_t> corners;
    for (std::string_view word = words.next(); !word.empty(); word = words.next())
      corners.push_back(obj_corner(word, out.points(), where));
    out.add_face(corners, where);
  }
}

// PLY

enum class PlyType : std::uint8_t { i8, u8, i16, u16, i32, u32, f32, f64 };
std::optional<PlyType> ply_type(std::string_view name) {
  static const std::map<std::string_view, PlyType> kNames{
      {"char", PlyType::i8},    {"int8", PlyType::i8},     {"uchar", PlyType::u8},
      {"uint8", PlyType::u8},   {"short", PlyType::i16},   {"int16", PlyType::i16},
      {"ushort", PlyType::u16}, {"uint16", PlyType::u16},  {"int", PlyType::i32},
      {"int32", PlyType::i32},  {"uint", PlyType::u32},    {"uint32", PlyType::u32},
      {"float", PlyType::f32},  {"float32", PlyType::f32}, {"double", PlyType::f64},
      {"float64", PlyType::f64}};
  const auto found = kNames.find(name);
  return found == kNames.end() ? std::nullopt : std::optional(found->second);
}

struct PlyProperty {
  std::string name;
  PlyType type;
  std::optional<PlyType> count;  ///< of a list
};
struct PlyElement {
  std::string name;
  std::size_t count = 0;
  std::vector<PlyProperty> properties;
};
struct PlyHeader {
  bool ascii = true;
  std::vector<PlyElement> elements;
};

PlyType ply_type_at(Words& words) {
  const std::string_view name = words.next();
  if (const auto type = ply_type(name)) return *type;
  refuse(words.where(), fmt::format("has '{}' where a type should be", name));
}

void read_ply_property(Words& words, PlyHeader& header) {
  if (header.elements.empty()) refuse(words.where(), "is a property before any element");
  Words look = words;
  PlyProperty property;
  if (look.next() == "list") {
    words = look;
    property.count = ply_type_at(words);
  }
  property.type = ply_type_at(words);
  property.name = words.next();
  header.elements.back().properties.push_back(property);
}

PlyHeader read_ply_header(Lines& lines) {
  PlyHeader header;
  bool has_format = false;
  if (lines.next() != std::optional<std::string_view>("ply"))
    refuse(lines.where(), "does not begin with 'ply'");
  while (const auto line = lines.next()) {
    Words words(*line, lines.where());
    const std::string_view what = words.next();
    if (what == "end_header") {
      if (!has_format) refuse(words.where(), "the header has no line 'format'");
      return header;
    }
    if (what == "format") {
      const std::string_view format = words.next();
      header.ascii = format == "ascii";
      if (!header.ascii && format != "binary_little_endian")
        refuse(words.where(),
               fmt::format("the format '{}' is not read here; write ascii or binary_little_endian", format));
      has_format = true;
    } else if (what == "element") {
      const std::string_view name = words.next();
      header.elements.push_back({std::string(name), words.number<std::uint32_t>("a count"), {}});
    } else if (what == "property") {
      read_ply_property(words, header);
    } else if (what != "comment" && what != "obj_info") {
      refuse(words.where(), fmt::format("'{}' is not known in a header", what));
    }
  }
  refuse(lines.where(), "the file ends within its header");
}

/// The body's numbers, one after the other.
class PlyNumbers {
 public:
  PlyNumbers(std::string_view bytes, bool ascii, const std::string& where)
      : bytes_(bytes), ascii_(ascii), where_(where) {}
  double next(PlyType type) { return ascii_ ? next_word() : next_binary(type); }
  const std::string& where() const { return where_; }

 private:
  double next_word() {
    constexpr std::string_view kBlank = " \t\r\n";
    const std::size_t from = std::min(bytes_.find_first_not_of(kBlank), bytes_.size());
    const std::size_t to = std::min(bytes_.find_first_of(kBlank, from), bytes_.size());
    Words word(bytes_.substr(from, to - from), where_);
    bytes_.remove_prefix(to);
    return word.number<double>("a number");
  }
  template <class T>
  double take() {
    T x;
    if (bytes_.size() < sizeof x) refuse(where_, "the file ends too early");
    std::memcpy(&x, bytes_.data(), sizeof x);
    bytes_.remove_prefix(sizeof x);
    return static_cast<double>(x);
  }
  double next_binary(PlyType type) {
    static_assert(std::endian::native == std::endian::little);
    switch (type) {
      case PlyType::i8:
        return take<std::int8_t>();
      case PlyType::u8:
        return take<std::uint8_t>();
      case PlyType::i16:
        return take<std::int16_t>();
      case PlyType::u16:
        return take<std::uint16_t>();
      case PlyType::i32:
        return take<std::int32_t>();
      case PlyType::u32:
        return take<std::uint32_t>();
      case PlyType::f32:
        return take<float>();
      case PlyType::f64:
        return take<double>();
    }
    return 0;
  }

  std::string_view bytes_;
  bool ascii_;
  std::string where_;
};

std::size_t list_length(PlyNumbers& numbers, PlyType type) {
  const double count = numbers.next(type);
  if (!(count >= 0 && count <= static_cast<double>(kMostFaceCorners)))
    refuse(numbers.where(),
           fmt::format("a list of {} numbers; at most {} are read", count, kMostFaceCorners));
  return static_cast<std::size_t>(count);
}

void read_ply_vertex(const PlyElement& element, PlyNumbers& numbers, Builder& out) {
  Vec3 p{std::numeric_limits<double>::quiet_NaN()};
  for (const PlyProperty& property : element.properties) {
    if (property.count) {
      for (std::size_t n = list_length(numbers, *property.count); n > 0; --n) numbers.next(property.type);
      continue;
    }
    const double x = numbers.next(property.type);
    for (int axis = 0; axis < 3; ++axis)
      if (property.name == std::string_view("xyz").substr(static_cast<std::size_t>(axis), 1)) p[axis] = x;
  }
  out.add_point(p, fmt::format("{}: point {}", numbers.where(), out.points()));
}

void read_ply_face(const PlyElement& element, std::size_t number, PlyNumbers& numbers, Builder& out) {
  const std::string where = fmt::format("{}: face {}", numbers.where(), number);
  for (const PlyProperty& property : element.properties) {
    std::size_t n = property.count ? list_length(numbers, *property.count) : 1;
    const bool is_corners =
        property.count && (property.name == "vertex_indices" || property.name == "vertex_index");
    std::vector<std::uint32_t> corners;
    for (; n > 0; --n) {
      const double x = numbers.next(property.type);
      if (!is_corners) continue;
      if (!(x >= 0 && x < static_cast<double>(out.points())))
        refuse(where, fmt::format("names point {}, but there are {}, counted from 0", x, out.points()));
      corners.push_back(static_cast<std::uint32_t>(x));
    }
    if (is_corners) out.add_face(corners, where);
  }
}

void skip_ply_row(const PlyElement& element, PlyNumbers& numbers) {
  for (const PlyProperty& property : element.properties)
    for (std::size_t n = property.count ? list_length(numbers, *property.count) : 1; n > 0; --n)
      numbers.next(property.type);
}

}  // namespace

Mesh parse_obj(std::string_view text, const std::string& file, const MeshImport& import) {
  Builder builder(file, import);
  Lines lines(text, file);
  while (const auto line = lines.next())
    read_obj_line(line->substr(0, line->find('#')), lines.where(), builder);
  return builder.finish();
}

Mesh parse_ply(std::string_view bytes, const std::string& file, const MeshImport& import) {
  Builder builder(file, import);
  Lines lines(bytes, file);
  const PlyHeader header = read_ply_header(lines);
  PlyNumbers numbers(lines.rest(), header.ascii, file);
  for (const PlyElement& element : header.elements) {
    // A row without properties takes no bytes: the count alone would keep us busy.
    for (std::size_t i = 0; i < element.count && !element.properties.empty(); ++i)
      if (element.name == "vertex")
        read_ply_vertex(element, numbers, builder);
      else if (element.name == "face")
        read_ply_face(element, i, numbers, builder);
      else
        skip_ply_row(element, numbers);
  }
  return builder.finish();
}

Mesh read_mesh(const std::filesystem::path& file, const MeshImport& import) {
  std::string ending = file.extension().string();
  std::transform(ending.begin(), ending.end(), ending.begin(),
                 [](char c) { return c >= 'A' && c <= 'Z' ? c + 32 : c; });
  if (ending != ".obj" && ending != ".ply")
    throw SetupError(ExitStatus::bad_data,
                     fmt::format("{}: meshes are read from .obj and .ply files", file.string()));
  std::ifstream in(file, std::ios::binary);
  const std::string bytes{std::istreambuf_iterator<char>(in), {}};
  if (!in)
    throw SetupError(ExitStatus::no_input,
                     fmt::format("cannot read the mesh {}; is the name right?", file.string()));
  return (ending == ".obj" ? parse_obj : parse_ply)(bytes, file.string(), import);
}

void require_body(Mesh& mesh, const std::string& file) {
  const MeshChecks found = check(mesh);
  if (!found.closed)
    refuse(file,
           "is open: some edge does not have exactly two faces that turn the same way. A body needs an "
           "inside; close its "
           "holes, and let the program that made it point all normals outward");
  if (found.volume_m3 < 0) turn_over(mesh);
}

}  // namespace csipose::sim
