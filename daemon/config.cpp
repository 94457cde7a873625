#include "daemon/config.h"

#include <fmt/format.h>
#include <fmt/ranges.h>
#include <toml++/toml.h>

#include <algorithm>
#include <fstream>
#include <optional>
#include <set>

#include "proto/result.h"
#include "proto/shape.h"

extern char** environ;

namespace csipose {
namespace {

namespace fs = std::filesystem;

constexpr std::string_view kEnvironmentPrefix = "CSIPOSED_";
constexpr std::size_t kMaxReceiverId = 32;

std::string location(const toml::node& node) {
  const toml::source_region& region = node.source();
  return fmt::format("{}:{}:{}", region.path ? *region.path : "?", region.begin.line, region.begin.column);
}

// ---- words for people ----

std::string_view type_name(const toml::node& node) {
  switch (node.type()) {
    case toml::node_type::table:
      return "a table";
    case toml::node_type::array:
      return "a list";
    case toml::node_type::string:
      return "a string";
    case toml::node_type::integer:
      return "an integer";
    case toml::node_type::floating_point:
      return "a number with a point";
    case toml::node_type::boolean:
      return "true or false";
    default:
      return "a date or time";
  }
}

std::string_view wanted_type(const Field& field) {
  constexpr std::array<std::string_view, 7> kNames = {"true or false",
                                                      "an integer",
                                                      "a number",
                                                      "a string",
                                                      "a list of integers",
                                                      "a list of strings",
                                                      "a list of three numbers"};
  return kNames[field.index()];
}

std::string allowed_words(const Allowed& allowed) {
  if (!allowed.words.empty()) return fmt::format("one of {}", fmt::join(allowed.words, ", "));
  if (allowed.min != allowed.max) return fmt::format("{} to {}", allowed.min, allowed.max);
  return "";
}

std::size_t edit_distance(std::string_view a, std::string_view b) {
  std::vector<std::size_t> row(b.size() + 1);
  for (std::size_t j = 0; j <= b.size(); ++j) row[j] = j;
  for (std::size_t i = 1; i <= a.size(); ++i) {
    std::size_t diagonal = std::exchange(row[0], i);
    for (std::size_t j = 1; j <= b.size(); ++j) {
      const std::size_t swap = diagonal + (a[i - 1] != b[j - 1]);
      diagonal = std::exchange(row[j], std::min({row[j] + 1, row[j - 1] + 1, swap}));
    }
  }
  return row.back();
}

template <class Owner>
std::string suggestion(std::span<const Key<Owner>> keys, std::string_view unknown) {
  const auto last_part = [](std::string_view name) { return name.substr(name.rfind('.') + 1); };
  std::string_view best;
  std::size_t best_distance = 4;  // further away is no misspelling
  for (const Key<Owner>& key : keys) {
    const bool other_section = last_part(key.name) == last_part(unknown);
    const std::size_t distance = other_section ? 1 : edit_distance(key.name, unknown);
    if (distance < best_distance) best = key.name, best_distance = distance;
  }
  return best.empty() ? "`csipose config default` lists all keys" : fmt::format("did you mean {}?", best);
}

// ---- one value ----

/// Empty = taken; otherwise why not.
using Complaint = std::string;

Complaint check_number(double value, const Allowed& allowed) {
  if (allowed.min == allowed.max || (value >= allowed.min && value <= allowed.max)) return {};
  return fmt::format("{} is out of range; allowed is {}", value, allowed_words(allowed));
}
Complaint check_word(std::string_view value, const Allowed& allowed) {
  if (allowed.words.empty() || std::ranges::count(allowed.words, value) > 0) return {};
  return fmt::format("\"{}\" is not known; allowed is {}", value, allowed_words(allowed));
}

/// Reads one scalar of type T; nullopt when the node is of another type.
template <class T>
std::optional<T> scalar(const toml::node& node) {
  if constexpr (std::is_same_v<T, bool>) {
    return node.is_boolean() ? node.value<bool>() : std::nullopt;
  } else if constexpr (std::is_same_v<T, int>) {
    const auto value = node.is_integer() ? node.value<std::int64_t>() : std::nullopt;
    if (!value) return std::nullopt;
    return static_cast<int>(std::clamp<std::int64_t>(*value, INT32_MIN, INT32_MAX));
  } else if constexpr (std::is_same_v<T, double>) {
    return node.is_number() ? node.value<double>() : std::nullopt;
  } else {
    return node.is_string() ? node.value<std::string>() : std::nullopt;
  }
}

template <class T>
Complaint check(const T& value, const Allowed& allowed) {
  if constexpr (std::is_same_v<T, std::string>)
    return check_word(value, allowed);
  else if constexpr (std::is_same_v<T, bool>)
    return {};
  else
    return check_number(value, allowed);
}

Complaint wrong_type(const Field& field, const toml::node& node) {
  return fmt::format("must be {}, but is {}", wanted_type(field), type_name(node));
}

template <class T>
Complaint assign(T* target, const Field& field, const toml::node& node, const Allowed& allowed) {
  const std::optional<T> value = scalar<T>(node);
  if (!value) return wrong_type(field, node);
  Complaint complaint = check(*value, allowed);
  if (complaint.empty()) *target = *value;
  return complaint;
}

template <class T>
Complaint read_list(std::vector<T>& out, const Field& field, const toml::node& node, const Allowed& allowed) {
  const toml::array* array = node.as_array();
  if (array == nullptr) return wrong_type(field, node);
  for (const toml::node& element : *array) {
    const std::optional<T> value = scalar<T>(element);
    if (!value) return fmt::format("must be {}, but holds {}", wanted_type(field), type_name(element));
    if (Complaint complaint = check(*value, allowed); !complaint.empty()) return complaint;
    out.push_back(*value);
  }
  return {};
}

template <class T>
Complaint assign(std::vector<T>* target, const Field& field, const toml::node& node, const Allowed& allowed) {
  std::vector<T> values;
  Complaint complaint = read_list(values, field, node, allowed);
  if (complaint.empty()) *target = std::move(values);
  return complaint;
}

Complaint assign(std::array<double, 3>* target, const Field& field, const toml::node& node,
                 const Allowed& allowed) {
  std::vector<double> values;
  Complaint complaint = read_list(values, field, node, allowed);
  if (complaint.empty() && values.size() != target->size())
    complaint = wrong_type(field, node) + " of another length";
  if (complaint.empty()) std::copy(values.begin(), values.end(), target->begin());
  return complaint;
}

// ---- all values ----

class Reader {
 public:
  void read_file(const fs::path& path) {
    try {
      const toml::table root = toml::parse_file(path.string());
      for (const auto& [name, node] : root) read_section(name.str(), node);
    } catch (const toml::parse_error& error) {
      const toml::source_position at = error.source().begin;
      complain(fmt::format("{}:{}:{}", path.string(), at.line, at.column),
               "no valid TOML: " + std::string(error.description()));
    }
  }

  /// `text` is a TOML value, or, where a string is wanted, just the string. `where` names its origin.
  void read_text(std::string_view name, std::string_view text, const std::string& where) {
    const Key<Config>* key = find(name);
    if (key == nullptr) return complain(where, unknown(name));
    const bool wants_string = std::holds_alternative<std::string*>(key->field(config));
    if (wants_string && !text.starts_with('"') && !text.starts_with('\'')) {
      const toml::value<std::string> plain{std::string(text)};
      return set(*key, plain, where);
    }
    try {
      const toml::table table = toml::parse(fmt::format("value = {}", text));
      set(*key, *table.get("value"), where);
    } catch (const toml::parse_error&) {
      complain(where,
               fmt::format("{} must be {}; \"{}\" is none", name, wanted_type(key->field(config)), text));
    }
  }

  void complain(const std::string& where, const std::string& words) {
    mistakes.push_back(where + ": " + words);
  }

  Config config;
  std::vector<std::string> mistakes;

 private:
  static const Key<Config>* find(std::string_view name) {
    const auto keys = config_keys();
    const auto found = std::ranges::find(keys, name, &Key<Config>::name);
    return found == keys.end() ? nullptr : &*found;
  }
  static bool is_section(std::string_view name) {
    return std::ranges::any_of(
        config_keys(), [&](const auto& key) { return key.name.starts_with(std::string(name) + '.'); });
  }
  static std::string unknown(std::string_view name) {
    return fmt::format("there is no key {}; {}", name, suggestion(config_keys(), name));
  }

  void read_section(std::string_view section, const toml::node& node) {
    if (section == "receiver") return read_receivers(node);
    if (!is_section(section))
      return complain(location(node), fmt::format("there is no section [{}]", section));
    const toml::table* table = node.as_table();
    if (table == nullptr)
      return complain(location(node), fmt::format("{} must be a section: [{}]", section, section));
    for (const auto& [name, value] : *table) {
      const std::string full = fmt::format("{}.{}", section, name.str());
      const Key<Config>* key = find(full);
      if (key != nullptr)
        set(*key, value, location(value));
      else
        complain(location(value), unknown(full));
    }
  }

  void set(const Key<Config>& key, const toml::node& node, const std::string& where) {
    const Field field = key.field(config);
    const Complaint complaint =
        std::visit([&](auto* target) { return assign(target, field, node, key.allowed); }, field);
    if (!complaint.empty()) return complain(where, fmt::format("{}: {}", key.name, complaint));
    config.origins[std::string(key.name)] = where;
  }

  void read_receivers(const toml::node& node) {
    const toml::array* array = node.as_array();
    if (array == nullptr || !array->is_homogeneous<toml::table>())
      return complain(location(node),
                      "receivers are written as tables of a list: [[receiver]], once for each");
    config.receivers.clear();  // a later file that names receivers names all of them
    for (const toml::node& element : *array) {
      ReceiverConfig receiver;
      for (const auto& [name, value] : *element.as_table()) set_receiver(receiver, name.str(), value);
      config.receivers.push_back(std::move(receiver));
    }
    config.origins["receiver"] = location(node);
  }

  void set_receiver(ReceiverConfig& receiver, std::string_view name, const toml::node& node) {
    const auto keys = receiver_keys();
    const auto key = std::ranges::find(keys, name, &Key<ReceiverConfig>::name);
    if (key == keys.end())
      return complain(location(node),
                      fmt::format("there is no key {} in [[receiver]]; {}", name, suggestion(keys, name)));
    const Field field = key->field(receiver);
    const Complaint complaint =
        std::visit([&](auto* target) { return assign(target, field, node, key->allowed); }, field);
    if (!complaint.empty()) complain(location(node), fmt::format("receiver.{}: {}", name, complaint));
  }
};

// ---- what only several keys together can say ----

class Consistency {
 public:
  explicit Consistency(Reader& reader) : reader_(reader), config_(reader.config) {}

  void check() {
    check_receiver_ids();
    if (config_.source.kind == "file")
      check_replay();
    else
      check_doors();
    if (config_.loop.jitter_ms >= config_.loop.budget_ms)
      complain("loop.budget_ms", fmt::format("{} leaves no time after loop.jitter_ms = {}; it must be larger",
                                             config_.loop.budget_ms, config_.loop.jitter_ms));
    if (!config_.model.sha256.empty() && !is_sha256(config_.model.sha256))
      complain("model.sha256", "must be 64 hexadecimal digits");
    if (config_.stream.socket.empty())
      complain("stream.socket", "must name the socket; without it nobody can subscribe");
  }

 private:
  void complain(const std::string& key, const std::string& words) {
    const auto origin = config_.origins.find(key);
    reader_.complain(origin == config_.origins.end() ? "default" : origin->second,
                     fmt::format("{}: {}", key, words));
  }

  static bool is_sha256(const std::string& text) {
    return text.size() == 64 && text.find_first_not_of("0123456789abcdef") == std::string::npos;
  }
  static bool is_id(const std::string& id) {
    return !id.empty() && id.size() <= kMaxReceiverId &&
           id.find_first_not_of("abcdefghijklmnopqrstuvwxyzABCDEFGHIJKLMNOPQRSTUVWXYZ0123456789_-") ==
               std::string::npos;
  }

  void check_receiver_ids() {
    std::set<std::string> seen;
    for (const ReceiverConfig& receiver : config_.receivers) {
      if (!is_id(receiver.id))
        complain("receiver", fmt::format("id \"{}\" must be 1 to {} letters, digits, - or _", receiver.id,
                                         kMaxReceiverId));
      else if (!seen.insert(receiver.id).second)
        complain("receiver", fmt::format("two receivers have the id {}", receiver.id));
    }
    if (!config_.receivers.empty() && config_.receivers.size() != kReceivers)
      complain("receiver", fmt::format("{} receivers are named; the network is made for exactly {}",
                                       config_.receivers.size(), kReceivers));
  }

  void check_replay() {
    const std::size_t count = config_.source.files.size();
    if (count < 1 || count > kReceivers)
      complain("source.files",
               fmt::format("source.kind = \"file\" needs 1 to {} files, {} are named", kReceivers, count));
  }

  void check_doors() {
    if (config_.receivers.empty())
      return complain(
          "receiver",
          "source.kind = \"agents\" needs three [[receiver]] tables; `csipose agent add` makes their keys");
    int local = 0;
    for (const ReceiverConfig& receiver : config_.receivers) {
      const int doors = !receiver.key_file.empty() + !receiver.peer.empty() + receiver.local;
      if (doors != 1)
        complain("receiver", fmt::format("{} has {} of key_file, peer and local; it needs exactly one",
                                         receiver.id, doors));
      if (receiver.peer.empty() == receiver.insecure)
        complain("receiver",
                 fmt::format("{}: peer and insecure = true go together, for data that nothing protects",
                             receiver.id));
      local += receiver.local;
      if (!receiver.peer.empty() && config_.ingest.listen_tcp.empty())
        complain(
            "receiver",
            fmt::format("{} has a peer, but ingest.listen_tcp names no address to connect to", receiver.id));
    }
    if (local > 1)
      complain("receiver", "local = true stands at several receivers; this computer has one driver");
  }

  Reader& reader_;
  Config& config_;
};

// ---- where settings lie ----

void read_folder(Reader& reader, const fs::path& folder) {
  std::error_code none;
  std::vector<fs::path> files;
  for (const auto& entry : fs::directory_iterator(folder, none))
    if (entry.path().extension() == ".toml") files.push_back(entry.path());
  std::ranges::sort(files);
  for (const fs::path& file : files) reader.read_file(file);
}

void read_files(Reader& reader, const std::string& named) {
  const fs::path file = named.empty() ? fs::path(kDefaultConfigFile) : fs::path(named);
  const bool there = fs::exists(file);
  if (!there && !named.empty())
    throw SetupError(ExitStatus::no_input,
                     fmt::format("there is no configuration file {}; --config must name one", named));
  if (there && !std::ifstream(file))
    throw SetupError(ExitStatus::no_permission,
                     fmt::format("the configuration file {} may not be read by this user", file.string()));
  if (there) reader.read_file(file);
  read_folder(reader, file.parent_path() / "conf.d");
}

/// CSIPOSED_WINDOW__HOP -> window.hop
void read_environment(Reader& reader, const std::pair<std::string, std::string>& variable) {
  std::string name = variable.first;
  if (!name.starts_with(kEnvironmentPrefix)) return;
  name.erase(0, kEnvironmentPrefix.size());
  if (const auto split = name.find("__"); split != std::string::npos) name.replace(split, 2, 1, '.');
  std::ranges::transform(name, name.begin(),
                         [](unsigned char c) { return static_cast<char>(std::tolower(c)); });
  reader.read_text(name, variable.second, "environment variable " + variable.first);
}

void read_option(Reader& reader, const std::string& option) {
  const auto equals = option.find('=');
  if (equals == std::string::npos) return reader.complain("--set " + option, "must be section.key=value");
  reader.read_text(option.substr(0, equals), option.substr(equals + 1), "--set " + option);
}

// ---- writing ----

std::string toml_string(std::string_view text) {
  std::string out = "\"";
  for (const char c : text) {
    if (c == '"' || c == '\\') out += '\\';
    if (static_cast<unsigned char>(c) < 0x20)
      out += fmt::format("\\u{:04X}", c);
    else
      out += c;
  }
  return out + '"';
}
std::string number(double value) {
  std::string text = fmt::format("{}", value);
  return text.find_first_of(".e") == std::string::npos ? text + ".0" : text;
}
std::string as_toml(bool value) { return value ? "true" : "false"; }
std::string as_toml(int value) { return fmt::format("{}", value); }
std::string as_toml(double value) { return number(value); }
std::string as_toml(const std::string& value) { return toml_string(value); }
template <class List>
std::string as_toml(const List& list) {
  std::vector<std::string> parts;
  for (const auto& element : list) parts.push_back(as_toml(element));
  return fmt::format("[{}]", fmt::join(parts, ", "));
}
std::string as_toml(const Field& field) {
  return std::visit([](const auto* value) { return as_toml(*value); }, field);
}

std::string help_of(const auto& key) {
  const std::string allowed = allowed_words(key.allowed);
  return fmt::format("# {}{}{}\n", key.help, allowed.empty() ? "" : fmt::format(" ({})", allowed),
                     key.change == Change::reload ? "; taken over on reload" : "");
}

void write_receivers(std::string& out, std::vector<ReceiverConfig> receivers, bool with_help) {
  for (ReceiverConfig& receiver : receivers) {
    out += "\n[[receiver]]\n";
    for (const auto& key : receiver_keys())
      out +=
          fmt::format("{}{} = {}\n", with_help ? help_of(key) : "", key.name, as_toml(key.field(receiver)));
  }
  if (!receivers.empty() || !with_help) return;
  out += "\n# [[receiver]]    exactly three of them, in the order in which the network knows them\n";
  for (const auto& key : receiver_keys()) out += fmt::format("# {}: {}\n", key.name, key.help);
}

}  // namespace

fs::path Config::in_run_dir(const std::string& path) const { return fs::path(daemon.run_dir) / path; }
fs::path Config::in_state_dir(const std::string& path) const { return fs::path(daemon.state_dir) / path; }

std::vector<std::pair<std::string, std::string>> process_environment() {
  std::vector<std::pair<std::string, std::string>> variables;
  for (char** entry = environ; *entry != nullptr; ++entry) {
    const std::string_view text = *entry;
    const auto equals = text.find('=');
    if (equals != std::string_view::npos)
      variables.emplace_back(text.substr(0, equals), text.substr(equals + 1));
  }
  return variables;
}

Config load_config(const ConfigSources& sources) {
  Reader reader;
  read_files(reader, sources.file);
  for (const auto& variable : sources.environment) read_environment(reader, variable);
  for (const std::string& option : sources.set) read_option(reader, option);
  if (reader.mistakes.empty()) Consistency(reader).check();
  if (!reader.mistakes.empty())
    throw SetupError(ExitStatus::bad_config, fmt::format("{}", fmt::join(reader.mistakes, "\n")));
  return std::move(reader.config);
}

std::string to_toml(const Config& config, bool with_help) {
  Config copy = config;
  std::string out;
  std::string_view section;
  for (const auto& key : config_keys()) {
    const std::string_view owner = key.name.substr(0, key.name.find('.'));
    if (owner != section) out += fmt::format("{}[{}]\n", out.empty() ? "" : "\n", owner);
    section = owner;
    const auto origin = config.origins.find(std::string(key.name));
    const bool say_origin = !with_help && origin != config.origins.end();
    out += fmt::format("{}{} = {}{}\n", with_help ? help_of(key) : "", key.name.substr(owner.size() + 1),
                       as_toml(key.field(copy)), say_origin ? "  # " + origin->second : "");
  }
  write_receivers(out, config.receivers, with_help);
  return out;
}

std::string values_as_text(const Config& config, bool (*wanted)(std::string_view key)) {
  Config copy = config;
  std::string text;
  for (const auto& key : config_keys())
    if (wanted(key.name)) text += fmt::format("{} = {}\n", key.name, as_toml(key.field(copy)));
  return text;
}

ReloadOutcome apply_reload(Config& running, Config fresh) {
  ReloadOutcome outcome;
  for (const auto& key : config_keys()) {
    const Field now = key.field(running), then = key.field(fresh);
    const std::string old_value = as_toml(now), new_value = as_toml(then);
    if (old_value == new_value) continue;
    if (key.change == Change::restart) {
      outcome.needs_restart.push_back(
          fmt::format("{} = {}: needs restart, {} stays", key.name, new_value, old_value));
      continue;
    }
    std::visit([&](auto* target) { *target = *std::get<decltype(target)>(then); }, now);
    outcome.applied.push_back(fmt::format("{} = {}", key.name, new_value));
  }
  if (running.receivers != fresh.receivers)
    outcome.needs_restart.push_back("[[receiver]] has changed: needs restart, the old receivers stay");
  return outcome;
}

}  // namespace csipose
