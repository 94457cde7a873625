#include "daemon/control.h"

#include <gtest/gtest.h>
#include <sys/socket.h>

#include <atomic>
#include <nlohmann/json.hpp>
#include <thread>

#include "proto/unix_socket.h"
#include "tests/daemon/pose_frames.h"
#include "tests/daemon/scratch_folder.h"

namespace csipose {
namespace {

using nlohmann::json;

ControlHandlers some_handlers() {
  ControlHandlers handlers;
  handlers.record_start = [] { return RecordingEntry{"/var/a.mcap", 0, true}; };
  handlers.record_stop = []() -> RecordingEntry {
    throw SetupError(ExitStatus::runtime, "Nothing is being recorded.");
  };
  handlers.record_list = [] {
    return std::vector<RecordingEntry>{{"a.mcap", 12, false}, {"b \"x\".mcap", 7, true}};
  };
  handlers.reload = [] { return std::vector<std::string>{"people.min_score = 0.7"}; };
  handlers.status = [] { return testing::busy_status(); };
  return handlers;
}

json answer_to(const std::string& line) { return json::parse(answer_control_request(line, some_handlers())); }

TEST(ControlRequest, IsCarriedOut) {
  EXPECT_EQ(answer_to(R"({"type":"record.start"})")["file"], "/var/a.mcap");
  EXPECT_EQ(answer_to(R"({"type":"record.list"})")["recordings"][1]["file"], "b \"x\".mcap");
  EXPECT_EQ(answer_to(R"({"type":"reload"})")["changes"][0], "people.min_score = 0.7");
  EXPECT_EQ(answer_to(R"({"type":"status"})")["frames_published"], 1234);
}

TEST(ControlRequest, IsRefusedWithWords) {
  EXPECT_EQ(answer_to(R"({"type":"record.stop"})")["text"], "Nothing is being recorded.");
  EXPECT_EQ(answer_to(R"({"type":"explode"})")["code"], "unknown_type");
  EXPECT_EQ(answer_to(R"({"type":"status","now":true})")["code"], "unknown_key");
  for (const char* line : {"", "{", "[]", "7", "null", "{\"type\":7}", "{}", "\xff\xfe"})
    EXPECT_EQ(answer_to(line)["code"], "bad_json") << line;
  EXPECT_EQ(json::parse(answer_control_request(R"({"type":"reload"})", {}))["code"], "not_here");
}

/// A server on a thread of its own, as the daemon's main thread serves it.
class Served {
 public:
  explicit Served(const std::string& path) : server_(path, "", -1, some_handlers()) {
    thread_ = std::thread([this] {
      while (!stop_) server_.serve(std::chrono::milliseconds(20));
    });
  }
  ~Served() {
    stop_ = true;
    thread_.join();
  }

 private:
  ControlServer server_;
  std::atomic<bool> stop_{false};
  std::thread thread_;
};

TEST(ControlServer, AnswersTheTool) {
  testing::ScratchFolder folder;
  const std::string path = folder / "control.sock";
  const Served served(path);
  EXPECT_EQ(json::parse(ask_daemon(path, "record.start"))["active"], true);
  try {
    ask_daemon(path, "record.stop");
    FAIL();
  } catch (const SetupError& error) {
    EXPECT_NE(std::string(error.what()).find("Nothing is being recorded."), std::string::npos);
  }
}

TEST(ControlServer, OutlivesGarbageAndTheSilent) {
  testing::ScratchFolder folder;
  const std::string path = folder / "control.sock";
  const Served served(path);
  std::vector<FileDescriptor> silent;
  for (int i = 0; i < 40; ++i) silent.push_back(connect_unix(path));
  const std::string garbage(50000, 'x');
  for (const FileDescriptor& fd : silent)
    send(fd.get(), garbage.data(), garbage.size(), MSG_NOSIGNAL | MSG_DONTWAIT);
  EXPECT_EQ(json::parse(ask_daemon(path, "reload"))["type"], "reload");
}

TEST(ControlServer, ComesBackWhenWoken) {
  testing::ScratchFolder folder;
  ControlServer server(folder / "control.sock", "", -1, some_handlers());
  std::array<int, 2> pair;
  ASSERT_EQ(socketpair(AF_UNIX, SOCK_STREAM, 0, pair.data()), 0);
  const FileDescriptor here(pair[0]), there(pair[1]);
  ASSERT_EQ(send(there.get(), "x", 1, 0), 1);
  server.serve(std::chrono::hours(1), here.get());  // an hour would be noticed
}

}  // namespace
}  // namespace csipose
