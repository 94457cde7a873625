#include "daemon/truth_client.h"

#include <gtest/gtest.h>
#include <sys/socket.h>

#include "sim/truth_server.h"
#include "tests/daemon/scratch_folder.h"

namespace csipose {
namespace {

using namespace std::chrono_literals;

class TruthReading : public ::testing::Test {
 protected:
  TruthReading() {
    hello_.scene = "test";
    hello_.rate_hz = 100;
  }
  static UtcTime time(std::int64_t ms) { return UtcTime{1790000000s + std::chrono::milliseconds(ms)}; }
  static Truth truth(std::uint64_t counter, std::int64_t ms) {
    Truth truth;
    truth.counter = counter;
    truth.sent = time(ms);
    truth.people.resize(1);
    return truth;
  }
  testing::ScratchFolder folder_;
  const std::string path_ = folder_ / "truth.sock";
  TruthHello hello_;
};

TEST_F(TruthReading, FindsTheInstantNearestToATime) {
  sim::TruthServer server(path_, hello_);
  // The hello waits in the server until somebody is let in.
  std::thread admit([&] {
    while (server.readers() == 0) server.admit();
  });
  TruthClient client(path_);
  admit.join();
  EXPECT_EQ(client.hello()->scene, "test");
  EXPECT_EQ(client.newest(), nullptr);
  EXPECT_EQ(client.at(time(0)), nullptr);
  for (int i = 0; i < 500; ++i) {
    server.send(truth(static_cast<std::uint64_t>(i), 10 * i));
    if (i % 50 == 49) client.drain();
  }
  EXPECT_EQ(client.newest()->counter, 499U);
  EXPECT_EQ(client.at(time(4004))->counter, 400U);
  EXPECT_EQ(client.at(time(4006))->counter, 401U);
  EXPECT_EQ(client.at(time(4995))->counter, 499U);
  EXPECT_EQ(client.at(time(5011)), nullptr) << "further away than one packet";
  EXPECT_EQ(client.at(time(1000)), nullptr) << "that old is forgotten";
  EXPECT_FALSE(client.closed());
}

TEST_F(TruthReading, SaysWhenTheSimulatorHasEnded) {
  auto server = std::make_unique<sim::TruthServer>(path_, hello_);
  std::thread admit([&] {
    while (server->readers() == 0) server->admit();
  });
  TruthClient client(path_);
  admit.join();
  server->send(truth(1, 0));
  server.reset();
  client.drain();
  client.drain();
  EXPECT_TRUE(client.closed());
  EXPECT_EQ(client.newest()->counter, 1U) << "what was said is known";
  EXPECT_THROW(TruthClient again(path_), SetupError);
}

TEST_F(TruthReading, WhatIsNoTruthSocketIsRefusedWithWords) {
  const FileDescriptor listener = listen_unix(path_, "");
  std::thread other([&] {
    FileDescriptor fd;
    while (!(fd = FileDescriptor(accept(listener.get(), nullptr, nullptr)))) std::this_thread::yield();
    EXPECT_EQ(::send(fd.get(), "{\"type\":\"pose\"}\n", 16, 0), 16);
  });
  try {
    TruthClient client(path_);
    ADD_FAILURE() << "taken";
  } catch (const SetupError& error) {
    EXPECT_EQ(error.status, ExitStatus::bad_data);
    EXPECT_NE(std::string(error.what()).find("'pose' is not known"), std::string::npos) << error.what();
  }
  other.join();
}

}  // namespace
}  // namespace csipose
