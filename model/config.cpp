#include "model/config.h"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <nlohmann/json.hpp>
#include <numeric>

#include "model/json_words.h"
#include "proto/result.h"
#include "proto/shape.h"

namespace csipose {
namespace {

struct Preset {
  std::string_view name;
  std::size_t dim, depth, heads, decoder_dim, ffn, kpt_hidden, queries, decoder_layers, refine_layers;
};
constexpr std::array<Preset, 5> kPresets = {{{"paper", 512, 12, 8, 256, 1024, 512, 100, 3, 2},
                                             {"base", 384, 8, 6, 256, 1024, 512, 50, 3, 2},
                                             {"small", 256, 6, 8, 192, 768, 384, 20, 3, 2},
                                             {"tiny", 128, 4, 4, 128, 512, 256, 12, 2, 1},
                                             {"micro", 64, 2, 4, 64, 256, 128, 8, 1, 1}}};
constexpr std::size_t kDecoderHeadWidth = 32;

/// Sizes by name, so that reading, writing and checking agree. Bounds keep a hostile file from asking for the
/// moon.
struct SizeField {
  std::string_view key;
  std::size_t NetworkConfig::*member;
  std::size_t least, most;
};
constexpr std::array<SizeField, 10> kSizes = {{{"dim", &NetworkConfig::dim, 4, 4096},
                                               {"depth", &NetworkConfig::depth, 1, 64},
                                               {"heads", &NetworkConfig::heads, 1, 64},
                                               {"decoder_dim", &NetworkConfig::decoder_dim, 4, 4096},
                                               {"decoder_heads", &NetworkConfig::decoder_heads, 1, 64},
                                               {"ffn", &NetworkConfig::ffn, 1, 16384},
                                               {"kpt_hidden", &NetworkConfig::kpt_hidden, 1, 16384},
                                               {"queries", &NetworkConfig::queries, 1, kTokens},
                                               {"decoder_layers", &NetworkConfig::decoder_layers, 1, 16},
                                               {"refine_layers", &NetworkConfig::refine_layers, 0, 16}}};
struct SwitchField {
  std::string_view key;
  bool NetworkConfig::*member;
  bool since_later = false;  ///< older files do not have it and mean false; nor is false written
};
constexpr std::array<SwitchField, 7> kSwitches = {
    {{"identity_conditioning", &NetworkConfig::identity_conditioning},
     {"query_conditioning", &NetworkConfig::query_conditioning, true},
     {"background_conditioning", &NetworkConfig::background_conditioning, true},
     {"receiver_tokens", &NetworkConfig::receiver_tokens, true},
     {"receiver_conditioning", &NetworkConfig::receiver_conditioning, true},
     {"flat_tokens", &NetworkConfig::flat_tokens, true},
     {"joint_sigma", &NetworkConfig::joint_sigma}}};

[[noreturn]] void refuse(const std::string& words) { throw SetupError(ExitStatus::bad_data, words); }

const nlohmann::json& member(const nlohmann::json& object, std::string_view key) {
  const auto found = object.find(std::string(key));
  if (found == object.end()) refuse(fmt::format("config has no '{}'", key));
  return *found;
}

std::size_t read_size(const nlohmann::json& object, const SizeField& field) {
  const nlohmann::json& value = member(object, field.key);
  if (!value.is_number_unsigned() || value < field.least || value > field.most)
    refuse(fmt::format("config '{}' is {}, not a whole number from {} to {}", field.key, brief(value),
                       field.least, field.most));
  return value.get<std::size_t>();
}

bool read_switch(const nlohmann::json& object, const SwitchField& field) {
  const nlohmann::json& value = member(object, field.key);
  if (!value.is_boolean())
    refuse(fmt::format("config '{}' is {}, not true or false", field.key, brief(value)));
  return value.get<bool>();
}

/// What no single number can show.
void check_together(const NetworkConfig& config) {
  if (config.dim % 4 != 0) refuse("config 'dim' is no multiple of 4, which the position code needs");
  if (config.dim % config.heads != 0) refuse("config 'dim' is no multiple of 'heads'");
  if (config.decoder_dim % config.decoder_heads != 0)
    refuse("config 'decoder_dim' is no multiple of 'decoder_heads'");
  if (config.identity_conditioning && config.refine_layers == 0)
    refuse("config has 'identity_conditioning' but no refinement layer");
  if (config.flat_tokens && config.background_conditioning)
    refuse("config has 'flat_tokens' and 'background_conditioning': a patch is of no one link");
  if (config.flat_tokens + config.receiver_tokens + config.receiver_conditioning > 1)
    refuse(
        "config has more than one of 'flat_tokens', 'receiver_tokens' and 'receiver_conditioning': a token "
        "is of a patch, of "
        "a receiver or of a link");
  if (config.joint_sigma && !config.identity_conditioning)
    refuse(
        "config has 'joint_sigma' without 'identity_conditioning': all people would get the same expected "
        "error");
}

bool same_sizes(const NetworkConfig& a, const NetworkConfig& b) {
  return std::all_of(kSizes.begin(), kSizes.end(),
                     [&](const SizeField& f) { return a.*f.member == b.*f.member; });
}

class TensorList {
 public:
  void add(const std::string& name, std::vector<std::size_t> shape) {
    specs_.push_back({name, std::move(shape)});
  }
  void linear(const std::string& name, std::size_t out, std::size_t in) {
    add(name + ".weight", {out, in});
    add(name + ".bias", {out});
  }
  void norm(const std::string& name, std::size_t width) {
    add(name + ".weight", {width});
    add(name + ".bias", {width});
  }
  void attention(const std::string& name, std::size_t width) {
    add(name + ".in_proj_weight", {3 * width, width});
    add(name + ".in_proj_bias", {3 * width});
    linear(name + ".out_proj", width, width);
  }
  std::vector<TensorSpec> take() { return std::move(specs_); }

 private:
  std::vector<TensorSpec> specs_;
};

void add_encoder(TensorList& list, const NetworkConfig& c) {
  list.add("encoder.patch_embed.proj.weight", {c.dim, c.token_numbers(), 1, 1});
  list.add("encoder.patch_embed.proj.bias", {c.dim});
  for (std::size_t i = 0; i < c.depth; ++i) {
    const std::string block = fmt::format("encoder.blocks.{}.", i);
    list.norm(block + "norm1", c.dim);
    list.linear(block + "attn.qkv", 3 * c.dim, c.dim);
    list.linear(block + "attn.proj", c.dim, c.dim);
    list.norm(block + "norm2", c.dim);
    list.linear(block + "mlp.fc1", 4 * c.dim, c.dim);
    list.linear(block + "mlp.fc2", c.dim, 4 * c.dim);
  }
  list.norm("encoder.norm", c.dim);
}

void add_layers(TensorList& list, const std::string& stack, std::size_t layers, const NetworkConfig& c) {
  for (std::size_t i = 0; i < layers; ++i) {
    const std::string layer = fmt::format("{}.layers.{}.", stack, i);
    list.attention(layer + "self_attn", c.decoder_dim);
    list.attention(layer + "cross_attn", c.decoder_dim);
    list.linear(layer + "linear1", c.ffn, c.decoder_dim);
    list.linear(layer + "linear2", c.decoder_dim, c.ffn);
    for (const char* norm : {"norm1", "norm2", "norm3"}) list.norm(layer + norm, c.decoder_dim);
  }
}

/// Heads 0 .. decoder_layers - 1 belong to the layers; the last one to the proposals.
void add_heads(TensorList& list, const NetworkConfig& c) {
  for (std::size_t i = 0; i <= c.decoder_layers; ++i) {
    const std::string kpt = fmt::format("kpt_branches.{}.", i);
    list.linear(fmt::format("cls_branches.{}", i), 1, c.decoder_dim);
    list.linear(kpt + "0", c.kpt_hidden, c.decoder_dim);
    list.linear(kpt + "2", c.kpt_hidden, c.kpt_hidden);
    list.linear(kpt + "4", c.kpt_hidden, c.kpt_hidden);
    list.linear(kpt + "6", kPoseWidth, c.kpt_hidden);
  }
}

void add_refinement(TensorList& list, const NetworkConfig& c) {
  if (c.refine_layers == 0) return;
  list.add("refine_query_embedding.weight", {kJoints, 2 * c.decoder_dim});
  if (c.identity_conditioning) list.linear("refine_identity", c.decoder_dim, c.decoder_dim);
  add_layers(list, "refine_decoder", c.refine_layers, c);
  for (std::size_t j = 0; j < c.refine_layers; ++j) {
    const std::string head = fmt::format("refine_kpt_branches.{}.", j);
    list.linear(head + "0", c.decoder_dim, c.decoder_dim);
    list.linear(head + "2", c.decoder_dim, c.decoder_dim);
    list.linear(head + "4", 3, c.decoder_dim);
  }
  if (c.joint_sigma) list.linear("sigma_branch", 1, c.decoder_dim);
}

}  // namespace

std::vector<std::int64_t> NetworkConfig::token_links_in_turn() const {
  std::vector<std::int64_t> links;
  for (std::size_t column = 0; column < token_grid().columns; ++column)
    for (std::size_t i = 0; i < token_links(); ++i)
      links.push_back(static_cast<std::int64_t>(token_link(column, i)));
  return links;
}

std::vector<std::size_t> NetworkConfig::tokens_there(LinkSet links) const {
  std::vector<std::size_t> tokens;
  for (std::size_t token = 0; token < token_grid().size(); ++token)
    if (has_token(token, links)) tokens.push_back(token);
  return tokens;
}

std::size_t NetworkConfig::token_count(LinkSet links) const {
  std::size_t columns = 0;
  for (std::size_t column = 0; column < token_grid().columns; ++column) columns += has_token(column, links);
  return kSamples * columns;
}

std::vector<std::string_view> preset_names() {
  std::vector<std::string_view> names;
  for (const Preset& preset : kPresets) names.push_back(preset.name);
  return names;
}

NetworkConfig preset_config(std::string_view name) {
  const auto* p =
      std::find_if(kPresets.begin(), kPresets.end(), [&](const Preset& it) { return it.name == name; });
  if (p == kPresets.end())
    throw SetupError(ExitStatus::usage, fmt::format("there is no network preset '{}'; take one of {}", name,
                                                    fmt::join(preset_names(), ", ")));
  NetworkConfig config;
  config.preset = p->name;
  config.dim = p->dim;
  config.depth = p->depth;
  config.heads = p->heads;
  config.decoder_dim = p->decoder_dim;
  config.decoder_heads = p->decoder_dim / kDecoderHeadWidth;
  config.ffn = p->ffn;
  config.kpt_hidden = p->kpt_hidden;
  config.queries = p->queries;
  config.decoder_layers = p->decoder_layers;
  config.refine_layers = p->refine_layers;
  return config;
}

std::string to_json(const NetworkConfig& config) {
  nlohmann::ordered_json object;
  for (const SizeField& field : kSizes) object[std::string(field.key)] = config.*field.member;
  for (const SwitchField& field : kSwitches)
    if (config.*field.member || !field.since_later) object[std::string(field.key)] = config.*field.member;
  return object.dump();
}

NetworkConfig config_from_json(const std::string& preset, const std::string& json) {
  const nlohmann::json object = nlohmann::json::parse(json, nullptr, /*allow_exceptions=*/false);
  if (!object.is_object()) refuse("config is no JSON object");
  std::size_t due = kSizes.size();
  for (const SwitchField& field : kSwitches) due += !field.since_later || object.contains(field.key);
  if (object.size() != due) refuse(fmt::format("config has {} entries, not {}", object.size(), due));
  NetworkConfig config;
  config.preset = preset;
  for (const SizeField& field : kSizes) config.*field.member = read_size(object, field);
  for (const SwitchField& field : kSwitches)
    config.*field.member = (!field.since_later || object.contains(field.key)) && read_switch(object, field);
  check_together(config);
  if (preset == "custom") return config;
  const std::vector<std::string_view> known = preset_names();
  if (std::find(known.begin(), known.end(), preset) == known.end())
    refuse(fmt::format("preset '{}' is none of {}, custom", preset, fmt::join(known, ", ")));
  if (!same_sizes(config, preset_config(preset)))
    refuse(fmt::format("preset is '{}' but config has other sizes than that preset", preset));
  return config;
}

void require_engine_tokens(const NetworkConfig& config) {
  if (config.flat_tokens)
    refuse(
        "the network takes flat tokens, which serve to compare with: `csipose-train experiment` learns and "
        "judges it, nothing else computes it; take weights without 'flat_tokens'");
}

std::vector<TensorSpec> required_tensors(const NetworkConfig& config) {
  TensorList list;
  add_encoder(list, config);
  list.linear("proj", config.decoder_dim, config.dim);
  list.add("query_embedding.weight", {config.queries, 2 * config.decoder_dim});
  if (config.query_conditioning) list.linear("query_proposal", config.decoder_dim, kPoseWidth);
  add_layers(list, "decoder", config.decoder_layers, config);
  add_heads(list, config);
  add_refinement(list, config);
  return list.take();
}

std::size_t parameter_count(const NetworkConfig& config) {
  std::size_t count = 0;
  for (const TensorSpec& spec : required_tensors(config))
    count += std::accumulate(spec.shape.begin(), spec.shape.end(), std::size_t{1}, std::multiplies<>());
  return count;
}

}  // namespace csipose
