#include "capture/agent/options.h"

#include <gtest/gtest.h>

#include "proto/result.h"

namespace csipose {
namespace {

TEST(AgentOptions, AreRead) {
  const AgentOptions options = parse_agent_options({"--id", "rx1", "--key", "k", "--to", "h:1", "--dat",
                                                    "a.dat", "--rate", "300", "--loop", "--inject-counter"});
  EXPECT_EQ(options.id, "rx1");
  EXPECT_EQ(options.key_file, "k");
  EXPECT_EQ(options.to, "h:1");
  EXPECT_EQ(options.dat_file, "a.dat");
  EXPECT_EQ(options.play.rate_hz, 300);
  EXPECT_TRUE(options.play.loop);
  EXPECT_TRUE(options.play.inject_counter);
}

TEST(AgentOptions, MistakesAreNamed) {
  const auto said = [](const std::vector<std::string>& arguments) -> std::string {
    try {
      parse_agent_options(arguments);
    } catch (const SetupError& error) {
      EXPECT_EQ(error.status, ExitStatus::usage);
      return error.what();
    }
    return "no error";
  };
  const auto names = [&](const std::vector<std::string>& arguments, const std::string& word) {
    EXPECT_NE(said(arguments).find(word), std::string::npos) << said(arguments);
  };
  names({}, "--id is missing");
  names({"--id", "rx1"}, "--key is missing");
  names({"--id", "rx1", "--key", "k"}, "--to is missing");
  names({"--id"}, "--id needs a value");
  names({"--frobnicate"}, "'--frobnicate'");
  names({"rx1"}, "'rx1'");
  names({"--id", "rx1", "--key", "k", "--to", "h:1", "--loop"}, "go with --dat");
  names({"--csitool-tcp", "h:1", "--key", "k"}, "takes the place");
  for (const char* rate : {"", "0", "-1", "nan", "inf", "1e9", "3x", "x"}) names({"--rate", rate}, "--rate");
}

TEST(AgentOptions, HelpNeedsNothingElse) {
  EXPECT_TRUE(parse_agent_options({"--help"}).help);
  EXPECT_TRUE(parse_agent_options({"--version"}).version);
}

}  // namespace
}  // namespace csipose
