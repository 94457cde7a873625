#include "daemon/config.h"

#include <gtest/gtest.h>

#include <fstream>
#include <sstream>

#include "proto/result.h"

namespace csipose {
namespace {

namespace fs = std::filesystem;

class Configuration : public ::testing::Test {
 protected:
  Configuration() : folder_(fs::path(::testing::TempDir()) / ("config." + std::to_string(getpid()))) {
    fs::create_directories(folder_ / "conf.d");
  }
  ~Configuration() override { fs::remove_all(folder_); }

  void write(const std::string& name, const std::string& text) { std::ofstream(folder_ / name) << text; }
  /// A main file that is complete for a replay, and `text` after it.
  void write_main(const std::string& text) {
    write("csiposed.toml", "[source]\nkind = \"file\"\nfiles = [\"a.dat\"]\n" + text);
  }

  ConfigSources sources() const { return {(folder_ / "csiposed.toml").string(), {}, {}}; }
  Config load() const { return load_config(sources()); }
  /// The words with which these sources are refused; "" when they are not.
  std::string refusal(const ConfigSources& from) const {
    try {
      load_config(from);
    } catch (const SetupError& error) {
      EXPECT_EQ(error.status, ExitStatus::bad_config);
      return error.what();
    }
    return "";
  }
  std::string refusal() const { return refusal(sources()); }
  std::string at(const std::string& place) const { return (folder_ / "csiposed.toml").string() + place; }

  fs::path folder_;
};

#define EXPECT_SAYS(text, part) EXPECT_NE((text).find(part), std::string::npos) << text

TEST_F(Configuration, TheLaterSourceWins) {
  write_main("[window]\nhop = 2\nmax_gap = 3\n[people]\nmax = 2\nmin_score = 0.25\n");
  write("conf.d/20.toml", "[window]\nhop = 5\n");
  write("conf.d/10.toml", "[window]\nhop = 4\nmax_gap = 4\n");
  ConfigSources from = sources();
  from.environment = {{"CSIPOSED_PEOPLE__MAX", "3"}, {"CSIPOSED_DAEMON__NAME", "attic"}, {"HOME", "/root"}};
  from.set = {"people.max=4"};
  const Config config = load_config(from);
  EXPECT_EQ(config.window.hop, 5);
  EXPECT_EQ(config.window.max_gap, 4);
  EXPECT_EQ(config.people.max, 4);
  EXPECT_EQ(config.people.min_score, 0.25);
  EXPECT_EQ(config.daemon.name, "attic");
  EXPECT_EQ(config.origins.at("people.max"), "--set people.max=4");
}

TEST_F(Configuration, AnUnknownKeyIsNamedWithItsPlaceAndTheNearestOne) {
  write_main("[window]\nhopp = 10\n");
  EXPECT_SAYS(refusal(), at(":5:8: there is no key window.hopp; did you mean window.hop?"));
}

TEST_F(Configuration, AKeyOfAnotherSectionIsRecognised) {
  write_main("[loop]\nhop = 10\n");
  EXPECT_SAYS(refusal(), "did you mean window.hop?");
}

TEST_F(Configuration, WrongTypesAndRangesSayWhatIsAllowed) {
  write_main("[window]\nhop = \"ten\"\nmax_gap = 20\nsample_rate_hz = true\n[ingest]\ncounter = \"guess\"\n");
  const std::string words = refusal();
  EXPECT_SAYS(words, at(":5:7: window.hop: must be an integer, but is a string"));
  EXPECT_SAYS(words, at(":6:11: window.max_gap: 20 is out of range; allowed is 0 to 19"));
  EXPECT_SAYS(words, "window.sample_rate_hz: must be a number, but is true or false");
  EXPECT_SAYS(words, "ingest.counter: \"guess\" is not known; allowed is one of automatic, csip, sequence16");
}

TEST_F(Configuration, BrokenTomlIsNamedWithItsPlace) {
  write_main("[window\nhop = 1\n");
  EXPECT_SAYS(refusal(), at(":4:"));
}

TEST_F(Configuration, UnknownSectionsAndMisusedOnes) {
  write_main("[mqtt]\nenabled = true\n");
  EXPECT_SAYS(refusal(), "there is no section [mqtt]");
  write("csiposed.toml", "window = 3\n");
  EXPECT_SAYS(refusal(), "window must be a section");
  write("csiposed.toml", "[receiver]\nid = \"rx1\"\n");
  EXPECT_SAYS(refusal(), "[[receiver]]");
}

TEST_F(Configuration, EnvironmentAndOptionsAreCheckedLikeFiles) {
  write_main("");
  ConfigSources from = sources();
  from.environment = {{"CSIPOSED_WINDOW__HOP", "many"}, {"CSIPOSED_NONSENSE", "1"}};
  from.set = {"loop.budget_ms=-1", "no.such=1", "hop"};
  const std::string words = refusal(from);
  EXPECT_SAYS(words,
              "environment variable CSIPOSED_WINDOW__HOP: window.hop must be an integer; \"many\" is none");
  EXPECT_SAYS(words, "environment variable CSIPOSED_NONSENSE: there is no key nonsense");
  EXPECT_SAYS(words, "--set loop.budget_ms=-1: loop.budget_ms: -1 is out of range");
  EXPECT_SAYS(words, "--set no.such=1: there is no key no.such");
  EXPECT_SAYS(words, "--set hop: must be section.key=value");
}

TEST_F(Configuration, ListsAndPositions) {
  write_main("[loop]\ncpu_affinity = [0, 1]\n[room]\nsize_m = [5, 4.5, 3]\n");
  EXPECT_EQ(load().loop.cpu_affinity, (std::vector<int>{0, 1}));
  EXPECT_EQ(load().room.size_m, (std::array<double, 3>{5, 4.5, 3}));
  write_main("[room]\nsize_m = [5, 4.5]\n");
  EXPECT_SAYS(refusal(), "must be a list of three numbers");
  write_main("[record]\ncontent = [\"csi\", \"sound\"]\n");
  EXPECT_SAYS(refusal(), "\"sound\" is not known");
}

constexpr const char* kThreeReceivers =
    "[ingest]\nlisten_tcp = \"tcp://127.0.0.1:8090\"\n"
    "[[receiver]]\nid = \"rx1\"\nkey_file = \"/k/1\"\n[[receiver]]\nid = \"rx2\"\nkey_file = \"/k/2\"\n"
    "[[receiver]]\nid = \"rx3\"\npeer = \"127.0.0.3\"\n";

TEST_F(Configuration, EachReceiverHasOneDoor) {
  write("csiposed.toml", std::string(kThreeReceivers) + "insecure = true\n");
  EXPECT_EQ(load().receivers.size(), 3u);
  write("csiposed.toml", kThreeReceivers);
  EXPECT_SAYS(refusal(), "rx3: peer and insecure = true go together");
  write("csiposed.toml", std::string(kThreeReceivers) + "insecure = true\nlocal = true\n");
  EXPECT_SAYS(refusal(), "rx3 has 2 of key_file, peer and local");
  write("csiposed.toml",
        "[[receiver]]\nid = \"rx1\"\nkey_file = \"k\"\n[[receiver]]\nid = \"rx1\"\nkey_file = \"k\"\n");
  EXPECT_SAYS(refusal(), "two receivers have the id rx1");
  EXPECT_SAYS(refusal(), "2 receivers are named; the network is made for exactly 3");
}

TEST_F(Configuration, LiveWithoutReceiversSaysWhatToDo) {
  write("csiposed.toml", "");
  EXPECT_SAYS(refusal(), "csipose agent add");
}

TEST_F(Configuration, TheBudgetMustExceedTheJitter) {
  write_main("[loop]\njitter_ms = 50\n");
  EXPECT_SAYS(refusal(), "loop.budget_ms: 50 leaves no time after loop.jitter_ms = 50");
}

TEST_F(Configuration, AFileThatIsNotThereIsNamed) {
  try {
    load_config({(folder_ / "none.toml").string(), {}, {}});
    FAIL();
  } catch (const SetupError& error) {
    EXPECT_EQ(error.status, ExitStatus::no_input);
    EXPECT_SAYS(std::string(error.what()), "none.toml");
  }
}

TEST_F(Configuration, WhatIsPrintedReadsBackTheSame) {
  write("csiposed.toml",
        std::string(kThreeReceivers) + "insecure = true\n[daemon]\nname = \"a \\\"b\\\" \\\\ c\"\n");
  const Config first = load();
  const std::string printed = to_toml(first, true);
  write("csiposed.toml", printed);
  const Config second = load();
  EXPECT_EQ(to_toml(second, true), printed);
  EXPECT_EQ(second.daemon.name, "a \"b\" \\ c");
  EXPECT_EQ(second.receivers, first.receivers);
}

TEST_F(Configuration, ReloadTakesWhatARunningDaemonCanTake) {
  write_main("[people]\nmin_score = 0.5\n[window]\nhop = 10\n");
  Config running = load();
  write_main("[people]\nmin_score = 0.75\n[window]\nhop = 5\n");
  const ReloadOutcome outcome = apply_reload(running, load());
  EXPECT_EQ(outcome.applied, std::vector<std::string>{"people.min_score = 0.75"});
  EXPECT_EQ(outcome.needs_restart, std::vector<std::string>{"window.hop = 5: needs restart, 10 stays"});
  EXPECT_EQ(running.people.min_score, 0.75);
  EXPECT_EQ(running.window.hop, 10);
}

TEST(ConfigurationPage, HoldsEveryDefaultAsItIs) {
  std::ifstream file((fs::path(CSIPOSE_TEST_DATA) / "../../docs/configuration.md").lexically_normal());
  std::stringstream page;
  page << file.rdbuf();
  EXPECT_SAYS(page.str(), to_toml(Config{}, true))
      << "put the output of `csipose config default` into docs/configuration.md";
}

}  // namespace
}  // namespace csipose
