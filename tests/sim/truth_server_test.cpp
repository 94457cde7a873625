#include "sim/truth_server.h"

#include <gtest/gtest.h>
#include <sys/socket.h>
#include <unistd.h>

namespace csipose::sim {
namespace {

class Reader {
 public:
  explicit Reader(const std::string& path) : fd_(connect_unix(path, {"the simulator", ""})) {}
  /// The lines that have come since the last call.
  std::vector<TruthMessage> read() {
    std::array<char, 65536> buffer;
    for (ssize_t got; (got = recv(fd_.get(), buffer.data(), buffer.size(), MSG_DONTWAIT)) > 0;)
      bytes_.append(buffer.data(), static_cast<std::size_t>(got));
    std::vector<TruthMessage> messages;
    for (std::size_t end; (end = bytes_.find('\n')) != std::string::npos; bytes_.erase(0, end + 1))
      messages.push_back(*parse_truth(bytes_.substr(0, end)));
    return messages;
  }

 private:
  FileDescriptor fd_;
  std::string bytes_;
};

class TruthServing : public ::testing::Test {
 protected:
  TruthServing() { hello_.scene = "test"; }
  ~TruthServing() override { ::unlink(path_.c_str()); }

  static Truth truth(std::uint64_t counter) {
    Truth truth;
    truth.counter = counter;
    truth.people.resize(2);
    return truth;
  }
  const std::string path_ = ::testing::TempDir() + "truth." + std::to_string(getpid());
  TruthHello hello_;
};

TEST_F(TruthServing, HelloAndThenEveryInstantForEveryReader) {
  TruthServer server(path_, hello_);
  Reader first(path_), second(path_);
  server.admit();
  EXPECT_EQ(server.readers(), 2U);
  server.send(truth(1));
  server.send(truth(2));
  for (Reader* reader : {&first, &second}) {
    const auto said = reader->read();
    ASSERT_EQ(said.size(), 3U);
    EXPECT_EQ(std::get<TruthHello>(said[0]).scene, "test");
    EXPECT_EQ(std::get<Truth>(said[2]).counter, 2U);
    EXPECT_EQ(std::get<Truth>(said[2]).dropped_before, 0U);
  }
}

TEST_F(TruthServing, WhoIsSlowLosesLinesAndIsToldWhileOthersLoseNone) {
  TruthServer server(path_, hello_);
  Reader slow(path_), quick(path_);
  server.admit();
  std::uint64_t sent = 0, quick_got = 0, next = 1, lost = 0;
  const auto read_slowly = [&] {
    for (const TruthMessage& message : slow.read())
      if (const auto* line = std::get_if<Truth>(&message)) {
        EXPECT_EQ(line->counter, next + line->dropped_before) << "what is missing is what was told";
        lost += line->dropped_before;
        next = line->counter + 1;
      }
  };
  for (int round = 0; round < 2; ++round) {
    for (int i = 0; i < 2000; ++i) {
      server.send(truth(++sent));
      if (sent % 50 == 0) quick_got += quick.read().size();
    }
    read_slowly();
  }
  EXPECT_EQ(quick_got, 4001U);
  server.send(truth(++sent));
  read_slowly();
  EXPECT_EQ(next, sent + 1) << "it is in step again";
  EXPECT_GT(lost, 1000U);
  EXPECT_EQ(server.readers(), 2U);
}

TEST_F(TruthServing, AReaderThatGoesIsForgotten) {
  TruthServer server(path_, hello_);
  {
    const Reader reader(path_);
    server.admit();
    server.send(truth(1));
  }
  server.send(truth(2));
  EXPECT_EQ(server.readers(), 0U);
}

TEST_F(TruthServing, ASocketThatIsServedIsNotTakenOver) {
  const TruthServer server(path_, hello_);
  EXPECT_THROW(TruthServer(path_, hello_), SetupError);
}

}  // namespace
}  // namespace csipose::sim
