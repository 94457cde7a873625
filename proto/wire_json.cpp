#include "proto/wire_json.h"

#include <fmt/format.h>

#include <cctype>
#include <charconv>
#include <cmath>
#include <iterator>
#include <limits>
#include <nlohmann/json.hpp>

namespace csipose {
namespace {

using google::protobuf::EnumDescriptor;
using google::protobuf::EnumValueDescriptor;
using google::protobuf::FieldDescriptor;
using google::protobuf::Message;
using google::protobuf::Reflection;
using Json = nlohmann::json;

/// Numbers that belong together stand in an array of their own: points, bones.
int row_length(const FieldDescriptor& field) {
  if (field.name() == "joints" || field.name() == "joints_raw") return 3;
  return field.name() == "bones" ? 2 : 0;
}

// ---- Writing ----

template <class Number>
void append_float(Number value, std::string& out) {
  if (!std::isfinite(value)) {
    out += "null";
  } else if constexpr (std::is_same_v<Number, float>) {
    fmt::format_to(std::back_inserter(out), "{:.4f}", value);
  } else {
    fmt::format_to(std::back_inserter(out), "{}", value);
  }
}

void append_string(std::string_view text, std::string& out) {
  // nlohmann's writer knows escapes and what to do with bytes that are no UTF-8; ids and words are short.
  out += Json(text).dump(-1, ' ', false, Json::error_handler_t::replace);
}

void append_enum(const EnumValueDescriptor& value, std::string& out) {
  out += '"';
  for (const char c : value.name()) out += static_cast<char>(std::tolower(static_cast<unsigned char>(c)));
  out += '"';
}

void append_object(const Message& message, std::string& out) {
  out += '{';
  append_json_fields(message, out);
  out += '}';
}

/// One value: of a single field, or number `i` of a repeated one.
struct FieldReader {
  const Message& message;
  const Reflection& reflection;
  const FieldDescriptor& field;
  int i;

  template <class Value>
  Value get(Value (Reflection::*single)(const Message&, const FieldDescriptor*) const,
            Value (Reflection::*repeated)(const Message&, const FieldDescriptor*, int) const) const {
    return field.is_repeated() ? (reflection.*repeated)(message, &field, i)
                               : (reflection.*single)(message, &field);
  }
};

void append_value(const FieldReader& at, std::string& out) {
  using R = Reflection;
  switch (at.field.cpp_type()) {
    case FieldDescriptor::CPPTYPE_FLOAT:
      return append_float(at.get(&R::GetFloat, &R::GetRepeatedFloat), out);
    case FieldDescriptor::CPPTYPE_DOUBLE:
      return append_float(at.get(&R::GetDouble, &R::GetRepeatedDouble), out);
    case FieldDescriptor::CPPTYPE_BOOL:
      out += at.get(&R::GetBool, &R::GetRepeatedBool) ? "true" : "false";
      return;
    case FieldDescriptor::CPPTYPE_UINT32:
      fmt::format_to(std::back_inserter(out), "{}", at.get(&R::GetUInt32, &R::GetRepeatedUInt32));
      return;
    case FieldDescriptor::CPPTYPE_UINT64: {
      // 2^53 is too small for times and session numbers, and those are the fixed64 ones.
      const char* form = at.field.type() == FieldDescriptor::TYPE_FIXED64 ? "\"{}\"" : "{}";
      fmt::format_to(std::back_inserter(out), fmt::runtime(form),
                     at.get(&R::GetUInt64, &R::GetRepeatedUInt64));
      return;
    }
    case FieldDescriptor::CPPTYPE_ENUM:
      return append_enum(*at.get(&R::GetEnum, &R::GetRepeatedEnum), out);
    case FieldDescriptor::CPPTYPE_STRING:
      return append_string(at.get(&R::GetString, &R::GetRepeatedString), out);
    case FieldDescriptor::CPPTYPE_MESSAGE:
      return append_object(at.field.is_repeated()
                               ? at.reflection.GetRepeatedMessage(at.message, &at.field, at.i)
                               : at.reflection.GetMessage(at.message, &at.field),
                           out);
    default:
      assert(false && "csipose.proto uses a type that the JSON side does not know");
  }
}

void append_array(FieldReader at, std::string& out) {
  const int size = at.reflection.FieldSize(at.message, &at.field), row = row_length(at.field);
  out += '[';
  for (at.i = 0; at.i < size; ++at.i) {
    if (at.i > 0) out += ',';
    if (row > 0 && at.i % row == 0) out += '[';
    append_value(at, out);
    if (row > 0 && (at.i + 1) % row == 0) out += ']';
  }
  out += ']';
}

bool is_left_out(const Message& message, const FieldDescriptor& field) {
  const Reflection& reflection = *message.GetReflection();
  if (!field.is_repeated() && field.cpp_type() == FieldDescriptor::CPPTYPE_ENUM)
    return reflection.GetEnumValue(message, &field) == 0;  // "unspecified" is no word of the stream
  if (!field.is_repeated()) return field.has_presence() && !reflection.HasField(message, &field);
  const bool numbers = field.cpp_type() != FieldDescriptor::CPPTYPE_MESSAGE &&
                       field.cpp_type() != FieldDescriptor::CPPTYPE_ENUM &&
                       field.cpp_type() != FieldDescriptor::CPPTYPE_STRING;
  return numbers && reflection.FieldSize(message, &field) == 0;
}

// ---- Reading ----

/// What was met instead, thrown through the recursion and caught in read_typed_json.
struct BadJson {
  std::string key, wanted;
};

template <class Number>
Number read_unsigned(const Json& json, const FieldDescriptor& field) {
  const bool as_text = field.type() == FieldDescriptor::TYPE_FIXED64;
  std::uint64_t value = 0;
  if (as_text && json.is_string()) {
    const auto& text = json.get_ref<const std::string&>();
    const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), value);
    if (error == std::errc{} && end == text.data() + text.size() && !text.empty())
      return static_cast<Number>(value);
  } else if (!as_text && json.is_number_unsigned()) {
    value = json.get<std::uint64_t>();
    if (value <= std::numeric_limits<Number>::max()) return static_cast<Number>(value);
  }
  throw BadJson{field.name(), as_text ? "a whole number as a string" : "a whole number that is not negative"};
}

double read_number(const Json& json, const FieldDescriptor& field) {
  if (json.is_null()) return std::numeric_limits<double>::quiet_NaN();
  if (!json.is_number()) throw BadJson{field.name(), "a number"};
  return json.get<double>();
}

std::string choices(const EnumDescriptor& type) {
  std::string text = "one of";
  for (int i = 1; i < type.value_count(); ++i)
    text += (i > 1 ? ", \"" : " \"") + json_enum_name(*type.value(i)) + '"';
  return text;
}

const EnumValueDescriptor* read_enum(const Json& json, const FieldDescriptor& field) {
  const EnumDescriptor& type = *field.enum_type();
  for (int i = 1; json.is_string() && i < type.value_count(); ++i)
    if (json_enum_name(*type.value(i)) == json.get_ref<const std::string&>()) return type.value(i);
  throw BadJson{field.name(), choices(type)};
}

void read_object(const Json& json, bool strict, const std::string& name, Message& message);

/// Sets a single field, or adds to a repeated one.
template <class Value>
void put(Message& message, const FieldDescriptor& field, Value value,
         void (Reflection::*single)(Message*, const FieldDescriptor*, Value) const,
         void (Reflection::*repeated)(Message*, const FieldDescriptor*, Value) const) {
  (message.GetReflection()->*(field.is_repeated() ? repeated : single))(&message, &field, std::move(value));
}

void read_value(const Json& json, bool strict, const FieldDescriptor& field, Message& message) {
  using R = Reflection;
  switch (field.cpp_type()) {
    case FieldDescriptor::CPPTYPE_FLOAT:
      return put(message, field, static_cast<float>(read_number(json, field)), &R::SetFloat, &R::AddFloat);
    case FieldDescriptor::CPPTYPE_DOUBLE:
      return put(message, field, read_number(json, field), &R::SetDouble, &R::AddDouble);
    case FieldDescriptor::CPPTYPE_BOOL:
      if (!json.is_boolean()) throw BadJson{field.name(), "true or false"};
      return put(message, field, json.get<bool>(), &R::SetBool, &R::AddBool);
    case FieldDescriptor::CPPTYPE_UINT32:
      return put(message, field, read_unsigned<std::uint32_t>(json, field), &R::SetUInt32, &R::AddUInt32);
    case FieldDescriptor::CPPTYPE_UINT64:
      return put(message, field, read_unsigned<std::uint64_t>(json, field), &R::SetUInt64, &R::AddUInt64);
    case FieldDescriptor::CPPTYPE_ENUM:
      return put(message, field, read_enum(json, field), &R::SetEnum, &R::AddEnum);
    case FieldDescriptor::CPPTYPE_STRING:
      if (!json.is_string()) throw BadJson{field.name(), "a string"};
      return put(message, field, json.get<std::string>(), &R::SetString, &R::AddString);
    case FieldDescriptor::CPPTYPE_MESSAGE: {
      const Reflection& reflection = *message.GetReflection();
      return read_object(json, strict, field.name(),
                         field.is_repeated() ? *reflection.AddMessage(&message, &field)
                                             : *reflection.MutableMessage(&message, &field));
    }
    default:
      assert(false && "csipose.proto uses a type that the JSON side does not know");
  }
}

void read_array(const Json& json, bool strict, const FieldDescriptor& field, Message& message) {
  if (!json.is_array()) throw BadJson{field.name(), "a list"};
  const auto row = static_cast<std::size_t>(row_length(field));
  for (const Json& element : json) {
    if (row == 0) {
      read_value(element, strict, field, message);
      continue;
    }
    if (!element.is_array() || element.size() != row)
      throw BadJson{field.name(), fmt::format("rows of {}", row)};
    for (const Json& number : element) read_value(number, strict, field, message);
  }
}

void read_object(const Json& json, bool strict, const std::string& name, Message& message) {
  if (!json.is_object()) throw BadJson{name, "an object"};
  for (const auto& [key, value] : json.items()) {
    const FieldDescriptor* field = message.GetDescriptor()->FindFieldByName(key);
    if (key == "type" && field == nullptr) continue;
    if (field == nullptr && strict) throw BadJson{key, ""};
    if (field == nullptr) continue;
    if (field->is_repeated()) {
      read_array(value, strict, *field, message);
    } else {
      read_value(value, strict, *field, message);
    }
  }
}

const FieldDescriptor* member_named(const Message& message, const Json& json) {
  const auto type = json.find("type");
  if (type == json.end() || !type->is_string()) return nullptr;
  return message.GetDescriptor()->FindFieldByName(type->get<std::string>());
}

std::string member_names(const Message& message) {
  std::string text;
  for (int i = 0; i < message.GetDescriptor()->field_count(); ++i)
    text += (i > 0 ? ", " : "") + message.GetDescriptor()->field(i)->name();
  return text;
}

}  // namespace

std::string json_enum_name(const EnumValueDescriptor& value) {
  std::string quoted;
  append_enum(value, quoted);
  return quoted.substr(1, quoted.size() - 2);
}

void append_json_fields(const Message& message, std::string& out) {
  const auto& type = *message.GetDescriptor();
  bool first = true;
  for (int i = 0; i < type.field_count(); ++i) {
    const FieldDescriptor& field = *type.field(i);
    if (is_left_out(message, field)) continue;
    if (!first) out += ',';
    first = false;
    fmt::format_to(std::back_inserter(out), "\"{}\":", field.name());
    const FieldReader at{message, *message.GetReflection(), field, 0};
    field.is_repeated() ? append_array(at, out) : append_value(at, out);
  }
}

std::optional<WireError> read_typed_json(ByteView line, bool strict, Message& message) {
  const Json json = Json::parse(line.begin(), line.end(), nullptr, /*allow_exceptions=*/false);
  if (!json.is_object())
    return WireError{"bad_json", "The line is not a JSON object.",
                     "Send one object per line, such as {\"type\":\"ping\"}."};
  const FieldDescriptor* member = member_named(message, json);
  if (member == nullptr)
    return WireError{"unknown_type", "The message has no \"type\" that is known here.",
                     "Use one of: " + member_names(message) + "."};
  try {
    read_object(json, strict, member->name(), *message.GetReflection()->MutableMessage(&message, member));
  } catch (const BadJson& bad) {
    if (bad.wanted.empty())
      return WireError{"unknown_key", fmt::format("\"{}\" is no key of \"{}\".", bad.key, member->name()),
                       "Leave it out."};
    return WireError{"bad_value", fmt::format("\"{}\" has a value of the wrong kind.", bad.key),
                     fmt::format("Give {}.", bad.wanted)};
  }
  return std::nullopt;
}

}  // namespace csipose
