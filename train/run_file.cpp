#include "train/run_file.h"

#include <fmt/format.h>
#include <fmt/ranges.h>
#include <toml++/toml.h>

#include <algorithm>
#include <fstream>
#include <span>
#include <sstream>
#include <string_view>
#include <variant>

#include "proto/result.h"

namespace csipose::train {
namespace {

using Field = std::variant<bool*, int*, double*, std::string*, std::vector<std::string>*>;

struct Key {
  std::string_view name;  ///< "pretrain.batch"
  Field (*field)(RunSettings&);
  double least = 0, most = 0;  ///< both 0: any
  std::vector<std::string_view> words{};
  std::string_view help;
};

#define FIELD(member) [](RunSettings& s) -> Field { return &s.member; }

const std::vector<Key>& keys() {
  static const std::vector<Key> table = {
      {"run.out", FIELD(run.out), 0, 0, {}, "folder for checkpoints, weights and log.csv"},
      {"run.seed", FIELD(run.seed), 0, 2e9, {}, "same seed, same run"},
      {"run.threads", FIELD(run.threads), 0, 1024, {}, "0: as many as the machine has"},
      {"run.device",
       FIELD(run.device),
       0,
       0,
       {"auto", "cpu", "cuda"},
       "where tensors are; auto: a CUDA device when libtorch has one"},
      {"run.precision",
       FIELD(run.precision),
       0,
       0,
       {"auto", "f32", "bf16"},
       "operands of matmuls; auto: the faster, timed at start. All else is float32"},
      {"run.checkpoint_minutes", FIELD(run.checkpoint_minutes), 0, 1e6, {}, "time between checkpoints"},
      {"run.log_s", FIELD(run.log_s), 0, 1e6, {}, "time between lines of progress; 0: every step"},
      {"run.stop_after_steps",
       FIELD(run.stop_after_steps),
       0,
       2e9,
       {},
       "write a checkpoint and stop when so many steps are made; 0: go on to the end"},

      {"network.preset", FIELD(network.preset), 0, 0, {"paper", "base", "small", "tiny", "micro"}, "sizes"},
      {"network.identity_conditioning",
       FIELD(network.identity_conditioning),
       0,
       0,
       {},
       "the refinement sees which person it refines"},
      {"network.query_conditioning",
       FIELD(network.query_conditioning),
       0,
       0,
       {},
       "each query of the decoder sees the pose it begins from"},
      {"network.background_conditioning",
       FIELD(network.background_conditioning),
       0,
       0,
       {},
       "tokens also say how much people move the channels of their link; needs backgrounds"},
      {"network.receiver_tokens",
       FIELD(network.receiver_tokens),
       0,
       0,
       {},
       "a token is what a sample has of a receiver, its three links side by side, in the place of one of "
       "each link"},
      {"network.receiver_conditioning",
       FIELD(network.receiver_conditioning),
       0,
       0,
       {},
       "each link's token also has the numbers of its receiver's other two links"},
      {"network.parity",
       FIELD(network.parity),
       0,
       0,
       {},
       "as the paper and its sources in everything that they leave open: all kinds of conditioning "
       "and proposal_bias off"},
      {"network.flat_tokens",
       FIELD(network.flat_tokens),
       0,
       0,
       {},
       "to compare with: 300 patches of the window as an image in the place of a token for each sample and "
       "link; no engine computes such weights"},
      {"network.init",
       FIELD(network.init),
       0,
       0,
       {"fan_in", "fixed"},
       "random encoders and predictors, deviation of their matrices: fan_in: 1 / sqrt(inputs); fixed: 0.02"},

      {"data.train", FIELD(data.train), 0, 0, {}, "data sets, each a folder; pooled and shuffled together"},
      {"data.options", FIELD(data.options), 0, 0, {}, "for the readers of data sets, \"name=value\""},
      {"data.take",
       FIELD(data.take),
       0,
       2e9,
       {},
       "learn from so many windows, spread evenly over the data sets; 0: from all"},
      {"data.most_people",
       FIELD(data.most_people),
       0,
       100,
       {},
       "fine-tuning learns from and chooses by windows with no more people; 0: any number"},
      {"data.hold_out",
       FIELD(data.hold_out),
       0,
       0.5,
       {},
       "share of the clips that fine-tuning does not learn from, to choose the best epoch by"},
      {"data.norm",
       FIELD(data.norm),
       0,
       0,
       {"corpus", "pooled", "background", "init", "none"},
       "corpus: amplitude to mean 0 and deviation 1, phase to deviation 1, measured on each data set; "
       "pooled: on all of them together; background: each channel of each link by its mean and deviation in "
       "the window's installation; init: as finetune.init was; none: raw"},

      {"pretrain.mask",
       FIELD(pretrain.mask),
       0,
       0,
       {"link", "time", "random", "block", "ijepa"},
       "what is hidden"},
      {"pretrain.epochs", FIELD(pretrain.epochs), 1, 1e6, {}, "passes through the data"},
      {"pretrain.batch", FIELD(pretrain.batch), 1, 65536, {}, "windows of a step, in each process"},
      {"pretrain.lr", FIELD(pretrain.lr), 0, 1, {}, "0: by preset, 5e-4 for paper and 1e-3 for the others"},
      {"pretrain.lr_start", FIELD(pretrain.lr_start), 0, 1, {}, "from here it rises in the warm-up"},
      {"pretrain.lr_final", FIELD(pretrain.lr_final), 0, 1, {}, "to here it falls by a cosine"},
      {"pretrain.warm_up", FIELD(pretrain.warm_up), 0, 1, {}, "share of the steps"},
      {"pretrain.weight_decay", FIELD(pretrain.weight_decay), 0, 1, {}, "of matrices; others have none"},
      {"pretrain.weight_decay_final",
       FIELD(pretrain.weight_decay_final),
       0,
       1,
       {},
       "to here it moves by a cosine; 0: it stays"},
      {"pretrain.ema",
       FIELD(pretrain.ema),
       0,
       0,
       {"cosine", "linear"},
       "how the target's momentum goes to 1"},
      {"pretrain.ema_start", FIELD(pretrain.ema_start), 0, 1, {}, "and from where"},

      {"finetune.init", FIELD(finetune.init), 0, 0, {}, "weights file to start from; empty: random weights"},
      {"finetune.init_from",
       FIELD(finetune.init_from),
       0,
       0,
       {"context", "target", "none"},
       "which of the file's encoders; none: random weights whatever init says"},
      {"finetune.epochs", FIELD(finetune.epochs), 1, 1e6, {}, "passes through the data"},
      {"finetune.batch", FIELD(finetune.batch), 1, 65536, {}, "windows of a step, in each process"},
      {"finetune.lr", FIELD(finetune.lr), 0, 1, {}, "0: by preset, 2e-5 for paper and 3e-4 for the others"},
      {"finetune.encoder_lr",
       FIELD(finetune.encoder_lr),
       0,
       100,
       {},
       "factor for the encoder; 0: by preset, 0.1 for paper and 0.3 for the others"},
      {"finetune.warm_up",
       FIELD(finetune.warm_up),
       0,
       1,
       {},
       "share of the steps in which the rate rises from 0"},
      {"finetune.schedule",
       FIELD(finetune.schedule),
       0,
       0,
       {"auto", "step", "cosine"},
       "step: a tenth after 80 % of the steps; cosine: down to a hundredth; auto: by preset, step for paper"},
      {"finetune.weight_decay", FIELD(finetune.weight_decay), 0, 1, {}, "of everything"},
      {"finetune.clip", FIELD(finetune.clip), 0, 1e9, {}, "largest norm of the gradient; 0: any"},
      {"finetune.dropout", FIELD(finetune.dropout), 0, 0.9, {}, "in the decoder"},
      {"finetune.cls", FIELD(finetune.cls), 0, 1e6, {}, "weight of the class loss"},
      {"finetune.kpt", FIELD(finetune.kpt), 0, 1e6, {}, "weight of the pose losses"},
      {"finetune.refine", FIELD(finetune.refine), 0, 1e6, {}, "weight of the refinement's losses"},
      {"finetune.error",
       FIELD(finetune.error),
       0,
       0,
       {"squared", "distance"},
       "of a joint in the pose losses: squared, as published, or the distance that the figures report"},
      {"finetune.root_relative",
       FIELD(finetune.root_relative),
       0,
       1e6,
       {},
       "weight, as a share of the pose losses', of the same errors as seen from each pose's root; 0: none"},
      {"finetune.ordered",
       FIELD(finetune.ordered),
       0,
       1e6,
       {},
       "weight of a plainer answer from the tokens' mean, which teaches the encoder and does not ship; 0: "
       "none"},
      {"finetune.overlay",
       FIELD(finetune.overlay),
       0,
       1,
       {},
       "share of the windows to which the people of another one of the same installation are added, by "
       "adding up how both "
       "depart from the background; of these the same share gets a third one's, and so on"},
      {"finetune.overlay_people",
       FIELD(finetune.overlay_people),
       2,
       100,
       {},
       "as long as there are no more people than these"},
      {"finetune.map",
       FIELD(finetune.map),
       0,
       1e6,
       {},
       "weight of another such answer: on which cells of the floor somebody is; 0: none"},
      {"finetune.encoder_only",
       FIELD(finetune.encoder_only),
       0,
       0,
       {},
       "the encoder alone learns, from those two answers; the decoder is not computed"},
      {"finetune.freeze_encoder",
       FIELD(finetune.freeze_encoder),
       0,
       0,
       {},
       "the encoder stays as it was taken over, and decoder and heads learn, at less than half the cost"},
      {"finetune.proposal_bias",
       FIELD(finetune.proposal_bias),
       0,
       0,
       {},
       "proposals start as the mean pose of the training labels"},
      {"finetune.lose_receiver",
       FIELD(finetune.lose_receiver),
       0,
       1,
       {},
       "share of the batches whose windows each lack one receiver"},
      {"finetune.lose_two_receivers", FIELD(finetune.lose_two_receivers), 0, 1, {}, "the same with two"},
      {"finetune.lose_links",
       FIELD(finetune.lose_links),
       0,
       1,
       {},
       "the same with one to three single links"},
      {"finetune.samples",
       FIELD(finetune.samples),
       1,
       20,
       {},
       "so many of a window's 20 samples, one of each part of it, others in each window and epoch, are "
       "encoded at "
       "first: steps cost less"},
      {"finetune.all_samples_from",
       FIELD(finetune.all_samples_from),
       0,
       1,
       {},
       "from this share of the steps that teach poses on all are, as in the daemon"},
      {"finetune.sigma_epochs",
       FIELD(finetune.sigma_epochs),
       0,
       1000,
       {},
       "epochs in which only the head for the expected error learns, after all others; 0: no such head"},
  };
  return table;
}

std::string allowed_words(const Key& key) {
  if (!key.words.empty()) return fmt::format("one of {}", fmt::join(key.words, ", "));
  if (key.least != key.most) return fmt::format("{} to {}", key.least, key.most);
  return "";
}

/// Empty = taken; otherwise why not.
std::string check_number(const Key& key, double value) {
  if (key.least == key.most || (value >= key.least && value <= key.most)) return {};
  return fmt::format("{} is out of range; allowed is {}", value, allowed_words(key));
}
std::string check_word(const Key& key, const std::string& value) {
  if (key.words.empty() || std::ranges::count(key.words, value) > 0) return {};
  return fmt::format("\"{}\" is not known; allowed is {}", value, allowed_words(key));
}

std::string assign(const Key&, bool* target, const toml::node& node) {
  if (!node.is_boolean()) return "must be true or false";
  *target = *node.value<bool>();
  return {};
}
std::string assign(const Key& key, int* target, const toml::node& node) {
  if (!node.is_integer()) return "must be an integer";
  const auto value = *node.value<std::int64_t>();
  const std::string complaint = check_number(key, static_cast<double>(value));
  if (complaint.empty()) *target = static_cast<int>(value);
  return complaint;
}
std::string assign(const Key& key, double* target, const toml::node& node) {
  if (!node.is_number()) return "must be a number";
  *target = *node.value<double>();
  return check_number(key, *target);
}
std::string assign(const Key& key, std::string* target, const toml::node& node) {
  if (!node.is_string()) return "must be a string";
  *target = *node.value<std::string>();
  return check_word(key, *target);
}
std::string assign(const Key&, std::vector<std::string>* target, const toml::node& node) {
  std::vector<std::string> values;
  if (!node.is_array()) return "must be a list of strings";
  for (const toml::node& element : *node.as_array()) {
    if (!element.is_string()) return "must be a list of strings";
    values.push_back(*element.value<std::string>());
  }
  *target = std::move(values);
  return {};
}

class Reader {
 public:
  void read_table(const toml::table& root, const std::string& file) {
    for (const auto& [section, node] : root) {
      if (!node.is_table()) {
        complain(location(file, node), fmt::format("{} is no section", section.str()));
        continue;
      }
      for (const auto& [name, value] : *node.as_table())
        set(fmt::format("{}.{}", section.str(), name.str()), value, location(file, value));
    }
  }

  /// "section.key=value": value is TOML, or, where a string is wanted, just the string.
  void read_override(const std::string& text) {
    const std::size_t equals = text.find('=');
    if (equals == std::string::npos) return complain("--set " + text, "is no section.key=value");
    const std::string name = text.substr(0, equals), value = text.substr(equals + 1);
    const auto key = std::ranges::find(keys(), name, &Key::name);
    if (key != keys().end() && std::holds_alternative<std::string*>(key->field(settings)))
      return set(name, toml::value<std::string>(value), "--set");
    try {
      const toml::table table = toml::parse(fmt::format("value = {}", value));
      set(name, *table.get("value"), "--set");
    } catch (const toml::parse_error&) {
      complain("--set " + text, "its value is no TOML");
    }
  }

  void refuse_if_wrong() const {
    if (!mistakes_.empty())
      throw SetupError(ExitStatus::bad_config, fmt::format("{}\n`csipose-train defaults` lists all keys",
                                                           fmt::join(mistakes_, "\n")));
  }

  RunSettings settings;

 private:
  static std::string location(const std::string& file, const toml::node& node) {
    return fmt::format("{}:{}", file, node.source().begin.line);
  }
  void complain(const std::string& where, const std::string& words) {
    mistakes_.push_back(where + ": " + words);
  }

  void set(const std::string& name, const toml::node& node, const std::string& where) {
    const auto key = std::ranges::find(keys(), name, &Key::name);
    if (key == keys().end()) return complain(where, fmt::format("there is no key {}", name));
    const std::string complaint =
        std::visit([&](auto* target) { return assign(*key, target, node); }, key->field(settings));
    if (!complaint.empty()) complain(where, fmt::format("{} {}", name, complaint));
  }

  std::vector<std::string> mistakes_;
};

std::string in_quotes(const std::string& text) {
  std::string out = "\"";
  for (const char c : text) {
    if (c == '"' || c == '\\') out += '\\';
    out += c;
  }
  return out + '"';
}
std::string value_text(const Field& field) {
  if (const auto* b = std::get_if<bool*>(&field)) return **b ? "true" : "false";
  if (const auto* i = std::get_if<int*>(&field)) return std::to_string(**i);
  if (const auto* d = std::get_if<double*>(&field)) return fmt::format("{}", **d);
  if (const auto* s = std::get_if<std::string*>(&field)) return in_quotes(**s);
  std::vector<std::string> words;
  for (const std::string& word : **std::get_if<std::vector<std::string>*>(&field))
    words.push_back(in_quotes(word));
  return fmt::format("[{}]", fmt::join(words, ", "));
}

void parse_into(Reader& reader, const std::string& text, const std::string& name) {
  try {
    reader.read_table(toml::parse(text), name);
  } catch (const toml::parse_error& error) {
    throw SetupError(ExitStatus::bad_config, fmt::format("{}:{}: no valid TOML: {}", name,
                                                         error.source().begin.line, error.description()));
  }
}

}  // namespace

RunSettings read_run_file(const std::filesystem::path& path, const std::vector<std::string>& set) {
  Reader reader;
  if (!path.empty()) {
    std::ifstream file(path);
    if (!file)
      throw SetupError(ExitStatus::no_input,
                       fmt::format("run file {} cannot be read; `csipose-train defaults` prints "
                                   "one to begin with",
                                   path.string()));
    std::stringstream text;
    text << file.rdbuf();
    parse_into(reader, text.str(), path.string());
  }
  for (const std::string& one : set) reader.read_override(one);
  reader.refuse_if_wrong();
  if (reader.settings.network.parity) {
    reader.settings.network.init = "fixed";
    reader.settings.network.identity_conditioning = reader.settings.network.query_conditioning =
        reader.settings.network.background_conditioning = reader.settings.network.receiver_tokens =
            reader.settings.network.receiver_conditioning = false;
    reader.settings.finetune.proposal_bias = false;
    reader.settings.finetune.ordered = reader.settings.finetune.map = reader.settings.finetune.root_relative =
        0;
  }
  if (reader.settings.network.flat_tokens && reader.settings.network.background_conditioning)
    throw SetupError(
        ExitStatus::bad_config,
        "network.flat_tokens and network.background_conditioning exclude each other: a patch is of "
        "no one link");
  if (reader.settings.network.flat_tokens + reader.settings.network.receiver_tokens +
          reader.settings.network.receiver_conditioning >
      1)
    throw SetupError(
        ExitStatus::bad_config,
        "network.flat_tokens, receiver_tokens and receiver_conditioning exclude each other: a token is of "
        "a patch, of a receiver or of a link");
  const auto& finetune = reader.settings.finetune;
  if (finetune.encoder_only &&
      ((finetune.ordered == 0 && finetune.map == 0) || finetune.freeze_encoder || finetune.sigma_epochs > 0))
    throw SetupError(ExitStatus::bad_config,
                     "finetune.encoder_only leaves nothing to learn, or nothing to learn it from: it needs "
                     "finetune.ordered or finetune.map above 0, freeze_encoder = false and sigma_epochs = 0");
  return reader.settings;
}

RunSettings parse_run_text(const std::string& text, const std::string& name) {
  Reader reader;
  parse_into(reader, text, name);
  reader.refuse_if_wrong();
  return reader.settings;
}

NetworkConfig network_of(const RunSettings& settings) {
  NetworkConfig config = preset_config(settings.network.preset);
  config.identity_conditioning = settings.network.identity_conditioning;
  config.query_conditioning = settings.network.query_conditioning;
  config.background_conditioning = settings.network.background_conditioning;
  config.receiver_tokens = settings.network.receiver_tokens;
  config.receiver_conditioning = settings.network.receiver_conditioning;
  config.flat_tokens = settings.network.flat_tokens;
  return config;
}

std::string to_toml(const RunSettings& settings, bool with_help) {
  RunSettings values = settings;
  std::string text;
  std::string_view section;
  for (const Key& key : keys()) {
    const std::string_view in = key.name.substr(0, key.name.find('.')), name = key.name.substr(in.size() + 1);
    if (in != section) text += fmt::format("{}[{}]\n", section.empty() ? "" : "\n", in);
    section = in;
    if (with_help) {
      const std::string allowed = allowed_words(key);
      text += fmt::format("# {}{}\n", key.help, allowed.empty() ? "" : "; " + allowed);
    }
    text += fmt::format("{} = {}\n", name, value_text(key.field(values)));
  }
  return text;
}

}  // namespace csipose::train
