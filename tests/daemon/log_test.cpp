#include "daemon/log.h"

#include <gtest/gtest.h>
#include <unistd.h>

#include <cstdlib>

namespace csipose {
namespace {

/// What a Log writes, read back through a pipe.
class LogLines : public ::testing::Test {
 protected:
  LogLines() {
    unsetenv("JOURNAL_STREAM");
    EXPECT_EQ(pipe(ends_), 0);
  }
  ~LogLines() override {
    close(ends_[0]);
    close(ends_[1]);
  }
  int descriptor() const { return ends_[1]; }
  std::string written() const {
    std::string text(65536, '\0');
    const ssize_t size = read(ends_[0], text.data(), text.size());
    text.resize(size > 0 ? static_cast<std::size_t>(size) : 0);
    return text;
  }
  int ends_[2]{};
};

int count(const std::string& text, const std::string& part) {
  int n = 0;
  for (auto at = text.find(part); at != std::string::npos; at = text.find(part, at + 1)) ++n;
  return n;
}

TEST_F(LogLines, SaysOnlyWhatIsUrgentEnough) {
  Log log(descriptor(), LogLevel::warn);
  log.info("quiet");
  log.warn("careful");
  log.set_level(LogLevel::debug);
  log.debug("chatty");
  const std::string text = written();
  EXPECT_EQ(count(text, "quiet"), 0);
  EXPECT_EQ(count(text, "warn  careful\n"), 1) << text;
  EXPECT_EQ(count(text, "debug chatty\n"), 1) << text;
}

TEST_F(LogLines, FoldsRepeatsAndSaysHowMany) {
  Log log(descriptor());
  for (int i = 0; i < 100; ++i) log.warn("receiver rx2 is silent");
  log.flush_repeats(std::chrono::steady_clock::now());
  EXPECT_EQ(count(written(), "rx2 is silent\n"), 1);
  log.flush_repeats(std::chrono::steady_clock::now() + std::chrono::minutes(2));
  EXPECT_EQ(count(written(), "rx2 is silent (said 99 more times in a minute)\n"), 1);
  log.warn("receiver rx2 is silent");
  EXPECT_EQ(count(written(), "rx2 is silent\n"), 1);
}

TEST_F(LogLines, SaysWhatWasFoldedBeforeItEnds) {
  {
    Log log(descriptor());
    for (int i = 0; i < 3; ++i) log.info("again");
  }
  EXPECT_EQ(count(written(), "again (said 2 more times in a minute)\n"), 1);
}

TEST_F(LogLines, GivesTheJournalItsPriority) {
  setenv("JOURNAL_STREAM", "8:1234", 1);
  Log log(descriptor());
  log.error("broken");
  EXPECT_EQ(written(), "<3>broken\n");
  unsetenv("JOURNAL_STREAM");
}

}  // namespace
}  // namespace csipose
