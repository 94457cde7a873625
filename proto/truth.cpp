#include "proto/truth.h"

#include <fmt/format.h>

#include <charconv>
#include <cmath>
#include <iterator>
#include <nlohmann/json.hpp>

namespace csipose {
namespace {

using nlohmann::json;
using nlohmann::ordered_json;

/// What is wrong with a line; caught in parse_truth().
struct Wrong {
  std::string words;
};

// ---- Writing ----

/// Metres with four decimals.
ordered_json row(const Point3& p) {
  const auto rounded = [](float metres) { return std::round(static_cast<double>(metres) * 1e4) / 1e4; };
  return {rounded(p.x), rounded(p.y), rounded(p.z)};
}

ordered_json skeleton() {
  ordered_json bones = ordered_json::array();
  for (const auto& [a, b] : kBones) bones.push_back({a, b});
  return {{"names", kJointNames}, {"bones", bones}};
}

void append_person(const TruePerson& person, std::string& out) {
  fmt::format_to(std::back_inserter(out), R"({{"id":{},"joints":[)", person.id);
  for (std::size_t j = 0; j < kJoints; ++j) {
    const Point3& p = person.joints[j];
    fmt::format_to(std::back_inserter(out), "{}[{:.4f},{:.4f},{:.4f}]", j == 0 ? "" : ",", p.x, p.y, p.z);
  }
  out += "]}";
}

// ---- Reading ----

const json& member(const json& object, const char* key) {
  const auto found = object.find(key);
  if (found == object.end()) throw Wrong{fmt::format("{} is missing", key)};
  return *found;
}

double number(const json& object, const char* key) {
  const json& value = member(object, key);
  if (!value.is_number()) throw Wrong{fmt::format("{} is no number", key)};
  return value.get<double>();
}

std::uint64_t count(const json& object, const char* key) {
  const json& value = member(object, key);
  if (!value.is_number_unsigned()) throw Wrong{fmt::format("{} is no count", key)};
  return value.get<std::uint64_t>();
}

std::string text(const json& object, const char* key) {
  const json& value = member(object, key);
  if (!value.is_string()) throw Wrong{fmt::format("{} is no text", key)};
  return value.get<std::string>();
}

const json& list(const json& object, const char* key, std::size_t most) {
  const json& value = member(object, key);
  if (!value.is_array() || value.size() > most)
    throw Wrong{fmt::format("{} is no list of at most {}", key, most)};
  return value;
}

Point3 point(const json& value, const char* key) {
  Point3 p;
  float* const xyz[] = {&p.x, &p.y, &p.z};
  if (!value.is_array() || value.size() != 3) throw Wrong{fmt::format("{} is no point", key)};
  for (std::size_t i = 0; i < 3; ++i) {
    if (!value[i].is_number() || std::abs(value[i].get<double>()) > 1e6)
      throw Wrong{fmt::format("{} is no point in metres", key)};
    *xyz[i] = value[i].get<float>();
  }
  return p;
}

/// Nanoseconds as a decimal string: 2^53 is too small for them.
UtcTime time_of(const json& object, const char* key) {
  const std::string digits = text(object, key);
  std::int64_t value = 0;
  const auto [end, error] = std::from_chars(digits.data(), digits.data() + digits.size(), value);
  if (error != std::errc() || end != digits.data() + digits.size() || value < 0)
    throw Wrong{fmt::format("{} is no time", key)};
  return UtcTime{Nanoseconds{value}};
}

/// Joints come in the sender's order; only ours is known.
void check_skeleton(const json& object) {
  if (member(member(object, "skeleton"), "names") != json(kJointNames))
    throw Wrong{"its joints are not ours"};
}

TruthHello hello_of(const json& object) {
  if (text(object, "api").substr(0, 2) != kTruthApi.substr(0, 2)) throw Wrong{"it speaks another version"};
  check_skeleton(object);
  TruthHello hello{text(object, "scene"),
                   count(object, "seed"),
                   number(object, "rate_hz"),
                   number(object, "speed"),
                   text(object, "impair"),
                   {},
                   {},
                   {}};
  const json& room = member(object, "room");
  hello.size_m = point(member(room, "size_m"), "size_m");
  hello.transmitter_m = point(member(room, "transmitter_m"), "transmitter_m");
  for (const json& receiver : list(room, "receivers_m", kReceivers))
    hello.receivers_m.push_back(point(receiver, "receivers_m"));
  return hello;
}

TruePerson person_of(const json& object) {
  TruePerson person;
  person.id = static_cast<std::uint32_t>(count(object, "id"));
  const json& joints = list(object, "joints", kJoints);
  if (joints.size() != kJoints)
    throw Wrong{fmt::format("{} joints where {} are due", joints.size(), kJoints)};
  for (std::size_t j = 0; j < kJoints; ++j) person.joints[j] = point(joints[j], "joints");
  return person;
}

Truth truth_of(const json& object) {
  Truth truth;
  truth.counter = count(object, "counter");
  truth.simulated_s = number(object, "t_s");
  truth.sent = time_of(object, "utc_ns");
  truth.dropped_before = static_cast<std::uint32_t>(count(object, "dropped_before"));
  for (const json& person : list(object, "people", kMaxTruePeople)) truth.people.push_back(person_of(person));
  return truth;
}

TruthMessage message_of(const json& object) {
  const std::string type = text(object, "type");
  if (type == "hello") return hello_of(object);
  if (type == "truth") return truth_of(object);
  throw Wrong{fmt::format("its type '{}' is not known", type)};
}

}  // namespace

std::string encode(const TruthHello& hello) {
  ordered_json receivers = ordered_json::array();
  for (const Point3& place : hello.receivers_m) receivers.push_back(row(place));
  const ordered_json line = {{"type", "hello"},
                             {"api", kTruthApi},
                             {"what", "truth"},
                             {"scene", hello.scene},
                             {"seed", hello.seed},
                             {"rate_hz", hello.rate_hz},
                             {"speed", hello.speed},
                             {"impair", hello.impair},
                             {"skeleton", skeleton()},
                             {"room",
                              {{"size_m", row(hello.size_m)},
                               {"transmitter_m", row(hello.transmitter_m)},
                               {"receivers_m", receivers}}}};
  return line.dump() + '\n';
}

std::string encode(const Truth& truth) {
  std::string line = fmt::format(
      R"({{"type":"truth","counter":{},"t_s":{:.6f},"utc_ns":"{}","dropped_before":{},"people":[)",
      truth.counter, truth.simulated_s, ns(truth.sent), truth.dropped_before);
  for (std::size_t p = 0; p < truth.people.size(); ++p) {
    if (p > 0) line += ',';
    append_person(truth.people[p], line);
  }
  return line + "]}\n";
}

Result<TruthMessage, std::string> parse_truth(std::string_view line) {
  if (line.size() > kMaxTruthLine) return std::string("it is longer than a line of truth may be");
  const json object = json::parse(line, nullptr, false);
  if (!object.is_object()) return std::string("it is no JSON object");
  try {
    return message_of(object);
  } catch (const Wrong& wrong) {
    return wrong.words;
  } catch (const json::exception& wrong) {  // a member of what is no object
    return std::string(wrong.what());
  }
}

}  // namespace csipose
