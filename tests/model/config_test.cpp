#include "model/config.h"

#include <gtest/gtest.h>

#include "proto/result.h"

namespace csipose {
namespace {

std::string refusal(const std::string& preset, const std::string& json) {
  try {
    config_from_json(preset, json);
  } catch (const SetupError& error) {
    EXPECT_EQ(error.status, ExitStatus::bad_data);
    return error.what();
  }
  return "";
}

std::string replaced(std::string text, const std::string& from, const std::string& to) {
  const auto place = text.find(from);
  EXPECT_NE(place, std::string::npos) << from;
  return text.replace(place, from.size(), to);
}

std::size_t encoder_parameters(const NetworkConfig& config) {
  std::size_t sum = 0;
  for (const TensorSpec& spec : required_tensors(config)) {
    if (spec.name.rfind("encoder.", 0) != 0) continue;
    std::size_t count = 1;
    for (const std::size_t extent : spec.shape) count *= extent;
    sum += count;
  }
  return sum;
}

// Counts as published for the paper's network: 37.86 M encoder, 8.44 M decoder.
TEST(Config, PaperHasAsManyParametersAsPublished) {
  NetworkConfig paper = preset_config("paper");
  EXPECT_EQ(encoder_parameters(paper), 37'860'864u);
  EXPECT_EQ(parameter_count(paper), 46'297'266u + 65'792u);
  paper.identity_conditioning = false;
  EXPECT_EQ(parameter_count(paper), 46'297'266u);
}

TEST(Config, PresetsHaveTheSizesTheyAreNamedFor) {
  const double millions[] = {46.3, 22.6, 9.5, 2.2, 0.34};
  const auto names = preset_names();
  ASSERT_EQ(names.size(), 5u);
  for (std::size_t i = 0; i < names.size(); ++i) {
    NetworkConfig config = preset_config(names[i]);
    config.identity_conditioning = false;
    EXPECT_NEAR(static_cast<double>(parameter_count(config)) / 1e6, millions[i], 0.03 * millions[i])
        << names[i];
    EXPECT_EQ(config.decoder_dim / config.decoder_heads, 32u) << names[i];
  }
}

TEST(Config, UnknownPresetIsRefusedWithTheList) {
  try {
    preset_config("huge");
    FAIL();
  } catch (const SetupError& error) {
    EXPECT_EQ(error.status, ExitStatus::usage);
    EXPECT_NE(std::string(error.what()).find("paper, base, small, tiny, micro"), std::string::npos)
        << error.what();
  }
}

TEST(Config, JsonRoundTrip) {
  for (const auto name : preset_names()) {
    NetworkConfig config = preset_config(name);
    EXPECT_EQ(config_from_json(std::string(name), to_json(config)), config);
    config.identity_conditioning = false;
    EXPECT_EQ(config_from_json(std::string(name), to_json(config)), config);
    config.query_conditioning = true;
    EXPECT_EQ(config_from_json(std::string(name), to_json(config)), config);
    config.background_conditioning = true;
    EXPECT_EQ(config_from_json(std::string(name), to_json(config)), config);
    EXPECT_EQ(required_tensors(config).front().shape, (std::vector<std::size_t>{config.dim, 120, 1, 1}));
    config.receiver_tokens = true;
    EXPECT_EQ(config_from_json(std::string(name), to_json(config)), config);
    EXPECT_EQ(required_tensors(config).front().shape, (std::vector<std::size_t>{config.dim, 360, 1, 1}));
    config.receiver_tokens = false;
    config.receiver_conditioning = true;
    EXPECT_EQ(config_from_json(std::string(name), to_json(config)), config);
    EXPECT_EQ(required_tensors(config).front().shape, (std::vector<std::size_t>{config.dim, 360, 1, 1}));
    config.background_conditioning = config.receiver_conditioning = false;
    config.flat_tokens = true;
    EXPECT_EQ(config_from_json(std::string(name), to_json(config)), config);
    EXPECT_EQ(required_tensors(config).front().shape, (std::vector<std::size_t>{config.dim, 36, 1, 1}));
    EXPECT_THROW(require_engine_tokens(config), SetupError);
  }
}

TEST(Config, TokensOfAbsentLinksAreNotThere) {
  NetworkConfig config = preset_config("micro");
  LinkSet links = LinkSet().set().reset(3).reset(4).reset(5);
  std::vector<std::size_t> tokens = config.tokens_there(links);
  ASSERT_EQ(tokens.size(), 120u);
  EXPECT_EQ(config.token_count(links), 120u);
  EXPECT_TRUE(std::is_sorted(tokens.begin(), tokens.end()));
  for (const std::size_t token : tokens) EXPECT_TRUE(token % 9 < 3 || token % 9 > 5);

  config.receiver_tokens = true;
  EXPECT_EQ(config.token_count(LinkSet().set()), 60u);
  links.reset(0).reset(8);  // their receivers have others
  tokens = config.tokens_there(links);
  ASSERT_EQ(tokens.size(), 40u);
  EXPECT_EQ(config.token_count(links), 40u);
  EXPECT_TRUE(std::is_sorted(tokens.begin(), tokens.end()));
  for (const std::size_t token : tokens) EXPECT_NE(token % 3, 1u);
}

TEST(Config, FilesFromBeforeQueryConditioningAreWithoutIt) {
  const std::string before = to_json(preset_config("micro"));
  EXPECT_EQ(before.find("query_conditioning"), std::string::npos);
  EXPECT_FALSE(config_from_json("micro", before).query_conditioning);
  const std::string off = replaced(before, "\"joint_sigma\"", "\"query_conditioning\":false,\"joint_sigma\"");
  EXPECT_FALSE(config_from_json("micro", off).query_conditioning);
  EXPECT_NE(refusal("micro", replaced(off, "conditioning\":false", "conditioning\":0")), "");
}

TEST(Config, RefusesWhatIsNoNetwork) {
  const std::string good = to_json(preset_config("micro"));
  EXPECT_EQ(refusal("micro", good), "");
  const std::pair<const char*, const char*> damages[] = {
      {"\"dim\":64", "\"dim\":66"},
      {"\"dim\":64", "\"dim\":-64"},
      {"\"dim\":64", "\"dim\":64.0"},
      {"\"dim\":64", "\"dim\":1e9"},
      {"\"dim\":64", "\"dim\":\"64\""},
      {"\"dim\":64", "\"dam\":64"},
      {"\"heads\":4", "\"heads\":5"},
      {"\"heads\":4", "\"heads\":0"},
      {"\"queries\":8", "\"queries\":181"},
      {"\"queries\":8", "\"queries\":[[8]]"},
      {"\"depth\":2", "\"depth\":4000000000"},
      {"\"decoder_heads\":2", "\"decoder_heads\":3"},
      {"\"refine_layers\":1", "\"refine_layers\":0"},
      {"\"joint_sigma\":false", "\"joint_sigma\":1"},
      {"{\"dim\"", "{\"more\":1,\"dim\""},
  };
  for (const auto& [from, to] : damages) EXPECT_NE(refusal("custom", replaced(good, from, to)), "") << to;
  EXPECT_NE(refusal("custom", "[]"), "");
  EXPECT_NE(refusal("custom", "{"), "");
}

TEST(Config, PresetNameMustGoWithTheSizes) {
  const std::string tiny = to_json(preset_config("tiny"));
  EXPECT_NE(refusal("micro", tiny).find("other sizes"), std::string::npos);
  EXPECT_NE(refusal("mini", tiny).find("none of"), std::string::npos);
  EXPECT_EQ(refusal("custom", tiny), "");
}

TEST(Config, FlatTokensAreOfNoOneLinkToTellOf) {
  NetworkConfig config = preset_config("micro");
  config.flat_tokens = config.background_conditioning = true;
  EXPECT_NE(refusal("micro", to_json(config)).find("flat_tokens"), std::string::npos);
  config.background_conditioning = false;
  config.receiver_tokens = true;
  EXPECT_NE(refusal("micro", to_json(config)).find("receiver_tokens"), std::string::npos);
  config.flat_tokens = false;
  EXPECT_EQ(refusal("micro", to_json(config)), "");
  config.receiver_conditioning = true;
  EXPECT_NE(refusal("micro", to_json(config)).find("receiver_conditioning"), std::string::npos);
}

TEST(Config, SigmaHeadNeedsIdentityConditioning) {
  NetworkConfig config = preset_config("micro");
  config.joint_sigma = true;
  EXPECT_EQ(refusal("micro", to_json(config)), "");
  config.identity_conditioning = false;
  EXPECT_NE(refusal("micro", to_json(config)).find("joint_sigma"), std::string::npos);
}

}  // namespace
}  // namespace csipose
