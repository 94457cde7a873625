#include "daemon/tool.h"

#include <gtest/gtest.h>
#include <sys/wait.h>
#include <unistd.h>

#include <array>
#include <cstdio>

namespace csipose {
namespace {

struct Outcome {
  int status = -1;
  std::string text;
};

/// What csipose says, and how it ends.
Outcome csipose(const std::string& arguments) {
  Outcome outcome;
  FILE* pipe = popen((CSIPOSE_BIN_DIR "/csipose " + arguments + " 2>&1").c_str(), "r");
  std::array<char, 4096> buffer;
  for (std::size_t n = 0; (n = fread(buffer.data(), 1, buffer.size(), pipe)) > 0;)
    outcome.text.append(buffer.data(), n);
  const int status = pclose(pipe);
  outcome.status = WIFEXITED(status) ? WEXITSTATUS(status) : -1;
  return outcome;
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

}  // namespace
}  // namespace csipose
