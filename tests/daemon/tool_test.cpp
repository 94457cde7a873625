#include "daemon/tool.h"

#include <gtest/gtest.h>
#include <sys/wait.h>
#include <unistd.h>

#include <array>
#include <csignal>
#include <cstdio>
#include <thread>

#include "daemon/child_process.h"
#include "daemon/own_daemon.h"
#include "tests/daemon/scratch_folder.h"

namespace csipose {
namespace {

struct Outcome {
  int status = -1;
  std::string text;
};

/// What a command says, and how it ends.
Outcome outcome_of(const std::string& command) {
  Outcome outcome;
  FILE* pipe = popen((command + " 2>&1").c_str(), "r");
  std::array<char, 4096> buffer;
  for (std::size_t n = 0; (n = fread(buffer.data(), 1, buffer.size(), pipe)) > 0;)
    outcome.text.append(buffer.data(), n);
  const int status = pclose(pipe);
  outcome.status = WIFEXITED(status) ? WEXITSTATUS(status) : -1;
  return outcome;
}

Outcome csipose(const std::string& arguments) { return outcome_of(CSIPOSE_BIN_DIR "/csipose " + arguments); }

/// What libgomp says of its settings, each time that it is loaded, where a daemon without a configuration starts.
std::string settings_of_libgomp(const std::string& environment) {
  const Outcome outcome = outcome_of("env -u GOMP_SPINCOUNT -u OMP_WAIT_POLICY OMP_DISPLAY_ENV=VERBOSE " +
                                     environment + " " CSIPOSE_BIN_DIR "/csiposed --config /nowhere");
  EXPECT_NE(outcome.text.find("/nowhere"), std::string::npos) << outcome.text;
  return outcome.text;
}

std::size_t count_of(const std::string& words, const std::string& text) {
  std::size_t count = 0;
  for (std::size_t at = 0; (at = text.find(words, at)) != std::string::npos; at += words.size()) ++count;
  return count;
}

TEST(Csiposed, ThreadsThatWaitSpinBriefly) {
  const std::string text = settings_of_libgomp("");
  EXPECT_EQ(count_of("GOMP_SPINCOUNT = '", text), 2U) << "it starts once more: " << text;
  EXPECT_EQ(count_of("GOMP_SPINCOUNT = '2000'", text), 1U) << text;
}

TEST(Csiposed, HowThreadsWaitIsLeftToWhoSaysIt) {
  const std::string spins = settings_of_libgomp("GOMP_SPINCOUNT=77");
  EXPECT_EQ(count_of("GOMP_SPINCOUNT = '", spins), 1U) << spins;
  EXPECT_EQ(count_of("GOMP_SPINCOUNT = '77'", spins), 1U) << spins;
  EXPECT_EQ(count_of("GOMP_SPINCOUNT = '", settings_of_libgomp("OMP_WAIT_POLICY=passive")), 1U);
}

TEST(NearestWord, FindsWhatWasMeant) {
  const std::vector<std::string> known = {"watch", "status", "record", "replay"};
  EXPECT_EQ(nearest_word("wacth", known), "watch");
  EXPECT_EQ(nearest_word("stats", known), "status");
  EXPECT_EQ(nearest_word("replya", known), "replay");
  EXPECT_EQ(nearest_word("xyzzy", known), "");
  EXPECT_EQ(nearest_word("", known), "");
}

TEST(Csipose, SaysItsVersion) {
  const Outcome outcome = csipose("--version");
  EXPECT_EQ(outcome.status, 0);
  EXPECT_EQ(outcome.text.find("csipose "), 0U);
  EXPECT_NE(outcome.text.find("commit"), std::string::npos);
}

TEST(Csipose, SuggestsTheCommandThatWasMeant) {
  const Outcome outcome = csipose("trian");
  EXPECT_EQ(outcome.status, static_cast<int>(ExitStatus::usage));
  EXPECT_NE(outcome.text.find("Did you mean 'train'"), std::string::npos) << outcome.text;
}

TEST(Csipose, WithoutACommandIsAUsageError) {
  EXPECT_EQ(csipose("").status, static_cast<int>(ExitStatus::usage));
  EXPECT_EQ(csipose("--no-such-option").status, static_cast<int>(ExitStatus::usage));
}

TEST(Csipose, SaysWhichProgramIsNotThere) {
  if (access(CSIPOSE_BIN_DIR "/csipose-train", X_OK) == 0) GTEST_SKIP() << "csipose-train is built";
  const Outcome outcome = csipose("train --help");
  EXPECT_EQ(outcome.status, static_cast<int>(ExitStatus::unavailable));
  EXPECT_NE(outcome.text.find("csipose-train is not there"), std::string::npos) << outcome.text;
}

TEST(CsiposeAgent, MakesListsAndRemovesKeys) {
  testing::ScratchFolder folder;
  const std::string keys = " --keys " + folder / "keys";
  const Outcome added = csipose("agent add rx1 --host 192.0.2.7" + keys);
  EXPECT_EQ(added.status, 0) << added.text;
  for (const char* part : {"[[receiver]]", "id = \"rx1\"", "192.0.2.7", "csipose-agent"})
    EXPECT_NE(added.text.find(part), std::string::npos) << part << "\n" << added.text;
  EXPECT_NE(csipose("agent add rx1" + keys).status, 0) << "a key in use was overwritten";
  EXPECT_EQ(csipose("agent add sim1 --sim" + keys).status, 0);
  const Outcome listed = csipose("agent list" + keys);
  EXPECT_EQ(listed.status, 0);
  EXPECT_NE(listed.text.find("rx1              live"), std::string::npos) << listed.text;
  EXPECT_NE(listed.text.find("sim1             simulated"), std::string::npos) << listed.text;
  EXPECT_EQ(csipose("agent remove rx1" + keys).status, 0);
  EXPECT_EQ(csipose("agent remove rx1" + keys).status, static_cast<int>(ExitStatus::no_input));
  EXPECT_EQ(csipose("agent remove ../keys/sim1" + keys).status, static_cast<int>(ExitStatus::usage));
  EXPECT_EQ(csipose("agent list --json" + keys).text.find("{\"id\":\"sim1\""), 0U);
}

TEST(CsiposeModel, ExportsToAFileThatIsNotThereYet) {
  testing::ScratchFolder folder;
  const std::string weights = folder / "w.safetensors", graph = folder / "network.onnx";
  const std::string command = "model export " + weights + " --out " + graph;
  EXPECT_EQ(csipose(command).status, static_cast<int>(ExitStatus::no_input));
  ASSERT_EQ(csipose("model init --preset micro --out " + weights).status, 0);
  const Outcome exported = csipose(command);
  EXPECT_EQ(exported.status, 0) << exported.text;
  EXPECT_NE(exported.text.find("UNTRAINED"), std::string::npos) << exported.text;
  EXPECT_GT(std::filesystem::file_size(graph), std::filesystem::file_size(weights));
  EXPECT_EQ(csipose(command).status, static_cast<int>(ExitStatus::cannot_create));
  EXPECT_EQ(csipose(command + " --force").status, 0);
  EXPECT_EQ(csipose("model export " + graph + " --out " + weights + "2").status,
            static_cast<int>(ExitStatus::bad_data));
}

TEST(CsiposeModel, BeginsWithTokensOfSeveralLinksWhereAsked) {
  testing::ScratchFolder folder;
  const std::string init = "model init --preset micro --force --out " + (folder / "w.safetensors");
  for (const auto& [option, key] :
       {std::pair(" --receiver-tokens", "\"receiver_tokens\":true"),
        std::pair(" --receiver-conditioning", "\"receiver_conditioning\":true")}) {
    EXPECT_EQ(csipose(init + option + " --parity").status, static_cast<int>(ExitStatus::usage));
    ASSERT_EQ(csipose(init + option).status, 0);
    const Outcome shown = csipose("model show --json " + (folder / "w.safetensors"));
    EXPECT_NE(shown.text.find(key), std::string::npos) << shown.text;
  }
  EXPECT_EQ(csipose(init + " --receiver-tokens --receiver-conditioning").status,
            static_cast<int>(ExitStatus::usage));
}

TEST(CsiposeReplay, SaysWhatIsWrongBeforeItStartsAnything) {
  const Outcome absent = csipose("replay no-such-file.mcap");
  EXPECT_EQ(absent.status, static_cast<int>(ExitStatus::no_input));
  EXPECT_NE(absent.text.find("no-such-file.mcap"), std::string::npos);
  for (const char* speed : {"fast", "0", "-1", "nan", "1x"})
    EXPECT_EQ(csipose(std::string("replay /dev/null --speed ") + speed).status,
              static_cast<int>(ExitStatus::usage))
        << speed;
}

TEST(OwnDaemon, TextsBecomeToml) {
  EXPECT_EQ(toml_text("a \"b\" \\c"), R"("a \"b\" \\c")");
  EXPECT_EQ(toml_list({"a", "b"}), R"(["a", "b"])");
  EXPECT_EQ(toml_list({}), "[]");
}

TEST(ChildProcess, TellsHowItEndedAndWhatItSaid) {
  const PrivateFolder folder;
  ChildProcess good("/bin/sh", {"-c", "echo one; echo two >&2; exit 7"}, folder / "log");
  EXPECT_EQ(good.wait_for(std::chrono::seconds(20)), 7);
  EXPECT_EQ(good.last_words(), "  one\n  two\n");
  EXPECT_EQ(good.last_words(1), "  two\n");
  EXPECT_THROW(ChildProcess("/no/such/program", {}, folder / "log"), SetupError);
}

TEST(ChildProcess, EndsWhenAsked) {
  const PrivateFolder folder;
  ChildProcess sleeper("/bin/sleep", {"1000"}, folder / "log");
  EXPECT_FALSE(sleeper.ended());
  EXPECT_FALSE(sleeper.wait_for(std::chrono::milliseconds(20)));
  sleeper.ask_to_stop();
  EXPECT_EQ(sleeper.wait(), 128 + SIGTERM);
}

}  // namespace
}  // namespace csipose
