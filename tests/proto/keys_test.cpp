#include "proto/keys.h"

#include <gtest/gtest.h>
#include <sys/stat.h>

#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <iterator>
#include <set>

namespace csipose {
namespace {

class Keys : public ::testing::Test {
 protected:
  Keys() {
    std::string pattern = ::testing::TempDir() + "csipose-keys-XXXXXX";
    folder_ = mkdtemp(pattern.data());
  }
  ~Keys() override { std::filesystem::remove_all(folder_); }
  std::string path(const std::string& file) const { return folder_ + "/" + file; }
  std::string text(const std::string& file) const {
    std::ifstream stream(path(file));
    return {std::istreambuf_iterator<char>(stream), {}};
  }
  std::string write(const std::string& file, const std::string& text, mode_t mode = 0400) const {
    std::ofstream(path(file)) << text;
    chmod(path(file).c_str(), mode);
    return path(file);
  }
  static std::string words_of(const std::string& file) {
    try {
      load_agent_key(file);
    } catch (const SetupError& error) {
      return error.what();
    }
    return "no error";
  }
  std::string folder_;
};

TEST_F(Keys, AreReadAsTheyWereMade) {
  create_agent_key(path("a"), "rx1", KeyKind::live);
  create_agent_key(path("b"), "rx-2_b", KeyKind::simulated);
  create_agent_key(path("c"), "rx3", KeyKind::replay);
  const AgentKey a = load_agent_key(path("a")), b = load_agent_key(path("b"));
  EXPECT_EQ(a.name, "rx1");
  EXPECT_EQ(a.kind, KeyKind::live);
  EXPECT_EQ(b.name, "rx-2_b");
  EXPECT_EQ(b.kind, KeyKind::simulated);
  EXPECT_EQ(load_agent_key(path("c")).kind, KeyKind::replay);
  EXPECT_NE(a.secret, b.secret);
  struct stat info {};
  ASSERT_EQ(stat(path("a").c_str(), &info), 0);
  EXPECT_EQ(info.st_mode & 0777, 0400u);
}

TEST_F(Keys, AreNeverOverwritten) {
  create_agent_key(path("a"), "rx1", KeyKind::live);
  const std::string before = text("a");
  EXPECT_THROW(create_agent_key(path("a"), "rx1", KeyKind::live), SetupError);
  EXPECT_EQ(text("a"), before);
}

TEST_F(Keys, NumbersOfTwoBytesAreNotDrawnTwice) {
  std::vector<std::uint16_t> taken;
  for (unsigned number = 0; number < 0x10000; ++number)
    if (number % 64 != 0) taken.push_back(static_cast<std::uint16_t>(number));
  for (int i = 0; i < 10; ++i)
    EXPECT_EQ(agent_number(draw_agent_key("rx1", KeyKind::live, taken)) % 64, 0) << i;
  for (unsigned number = 0; number < 0x10000; number += 64)
    taken.push_back(static_cast<std::uint16_t>(number));
  EXPECT_THROW(draw_agent_key("rx1", KeyKind::live, taken), SetupError);
}

TEST_F(Keys, InAFolderHaveOtherNumbers) {
  constexpr int kBefore = 1'500, kNew = 130;  // by chance alone all would differ one time in twenty
  std::set<std::uint16_t> numbers;
  for (int i = 0; i < kBefore; ++i) {
    const AgentKey key = draw_agent_key("rx1", KeyKind::live, {});
    std::string digits;
    for (const std::uint8_t byte : key.secret)
      for (const int nibble : {byte >> 4, byte & 15}) digits += "0123456789abcdef"[nibble];
    write("old" + std::to_string(i), "csipose-key 1 live rx1 " + digits + "\n");
    numbers.insert(agent_number(key));
  }
  for (int i = 0; i < kNew; ++i) {
    create_agent_key(path(std::to_string(i)), "rx1", KeyKind::live);
    EXPECT_TRUE(numbers.insert(agent_number(load_agent_key(path(std::to_string(i))))).second) << i;
  }
}

TEST_F(Keys, OthersMayNotReadThem) {
  create_agent_key(path("a"), "rx1", KeyKind::live);
  for (const mode_t mode : {0440u, 0404u, 0640u, 0410u, 0402u}) {
    chmod(path("a").c_str(), mode);
    EXPECT_NE(words_of(path("a")).find("chmod 0400"), std::string::npos) << mode;
  }
}

TEST_F(Keys, WhatIsWrongWithAFileIsSaid) {
  const std::string digits(64, 'a');
  const auto said = [&](const std::string& text, const std::string& words) {
    std::filesystem::remove(path("k"));
    const std::string all = words_of(write("k", text));
    EXPECT_NE(all.find(words), std::string::npos) << all;
  };
  EXPECT_NE(words_of(path("absent")).find("csipose agent add"), std::string::npos);
  EXPECT_NE(words_of(folder_).find("regular file"), std::string::npos);
  said("", "not one line");
  said("csipose-key 1 live rx1\n", "not one line");
  said("csipose-key 2 live rx1 " + digits + "\n", "version");
  said("csipose-key 1 real rx1 " + digits + "\n", "kind");
  said("csipose-key 1 live RX1 " + digits + "\n", "id");
  said("csipose-key 1 live rx1 " + digits.substr(1) + "\n", "64 hexadecimal");
  said("csipose-key 1 live rx1 " + digits.substr(1) + "g\n", "64 hexadecimal");
  said("csipose-key 1 live rx1 " + digits + "aa\n", "64 hexadecimal");
  said(std::string(5000, 'x'), "not one line");
}

TEST_F(Keys, WordsNeverHoldTheSecret) {
  const std::string digits = "0123456789abcdef0123456789abcdef0123456789abcdef0123456789abcdef";
  for (const char* kind : {"csipose-key 9 live rx1 ", "csipose-key 1 x rx1 ", "csipose-key 1 live X "})
    EXPECT_EQ(parse_agent_key(kind + digits).error().find("0123"), std::string::npos);
}

TEST_F(Keys, ReceiverIdsAreChecked) {
  for (const char* name : {"", "RX", "a b", "a/b", "..", "012345678901234567890123456789012"})
    EXPECT_THROW(create_agent_key(path("x"), name, KeyKind::live), SetupError) << name;
  EXPECT_FALSE(std::filesystem::exists(path("x")));
}

TEST(AgentStartLine, NamesKeyAgentAndDaemon) {
  EXPECT_EQ(agent_start_line("/etc/csiposed/keys/rx1.key", "rx1", "pi.lan", 8481),
            "scp -p pi.lan:/etc/csiposed/keys/rx1.key rx1.key && csipose-agent --id rx1 --key rx1.key --to "
            "pi.lan:8481");
}

}  // namespace
}  // namespace csipose
