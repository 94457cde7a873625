// tests/daemon/daemon_fixture.h - a folder with model, recording and configuration, and csiposed run in it.
#pragma once

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <memory>

#include "daemon/stream_client.h"
#include "model/model.h"
#include "proto/keys.h"
#include "tests/capture/made_up_packets.h"
#include "tests/daemon/program.h"
#include "tests/shared_data.h"

namespace csipose::testing {

namespace fs = std::filesystem;

/// What one subscriber got: every message as it came, and the frames among them.
struct Received {
  std::vector<std::string> raw;
  std::vector<PoseFrame> frames;
  std::string bye;
};

class DaemonTest : public ::testing::Test {
 protected:
  DaemonTest()
      : folder_(fs::temp_directory_path() /
                fmt::format("csiposed.{}.{}", getpid(),
                            ::testing::UnitTest::GetInstance()->current_test_info()->name())) {
    fs::remove_all(folder_);
    fs::create_directories(folder_);
    write_file("micro.safetensors", random_weights(preset_config("micro"), 1, HeadInit::random));
    write_config("");
  }
  ~DaemonTest() override { fs::remove_all(folder_); }

  void write_file(const std::string& name, const std::vector<std::uint8_t>& bytes) const {
    std::ofstream(folder_ / name, std::ios::binary)
        .write(reinterpret_cast<const char*>(bytes.data()), static_cast<std::streamsize>(bytes.size()));
  }
  /// What every configuration here has, and `more`. Everybody is shown, whatever the score: the weights are
  /// random.
  void write_config(const std::string& more) const {
    std::ofstream(folder_ / "csiposed.toml") << fmt::format(
        "[daemon]\nrun_dir = \"{0}\"\nstate_dir = \"{0}\"\n[model]\npath = "
        "\"{0}/micro.safetensors\"\nthreads = 1\nprecision = "
        "\"f32\"\n{1}",
        folder_.string(), more);
  }
  std::unique_ptr<Program> start(const std::vector<std::string>& sets) const {
    std::vector<std::string> arguments = {"--config", (folder_ / "csiposed.toml").string()};
    for (const std::string& set : sets) arguments.insert(arguments.end(), {"--set", set});
    return std::make_unique<Program>("csiposed", arguments, folder_ / "log");
  }
  std::vector<std::string> replay_of(const std::vector<std::string>& files) const {
    std::vector<std::string> quoted;
    for (const std::string& file : files) quoted.push_back('"' + file + '"');
    return {"source.kind=file", fmt::format("source.files=[{}]", fmt::join(quoted, ",")), "source.speed=0",
            "people.min_score=0"};
  }

  /// Made-up recordings of three receivers, one .dat file each.
  std::vector<std::string> made_up_files(std::int64_t frames, double hz = 300) const {
    MadeUpTransmitter transmitter;
    transmitter.frames = frames;
    transmitter.hz = hz;
    transmitter.frame_record = [](std::int64_t frame) {
      return csip_frame(static_cast<std::uint64_t>(frame) + 1);
    };
    std::vector<MadeUpReceiver> receivers(3);
    for (MadeUpReceiver& receiver : receivers) receiver.loss = 0.01;
    std::vector<std::vector<std::uint8_t>> files(3);
    for (const StoredPacket& packet : make_packets(transmitter, receivers))
      files[packet.receiver].insert(files[packet.receiver].end(), packet.bytes.begin(), packet.bytes.end());
    std::vector<std::string> names;
    for (std::size_t r = 0; r < files.size(); ++r) {
      names.push_back((folder_ / fmt::format("rx{}.dat", r + 1)).string());
      write_file(fmt::format("rx{}.dat", r + 1), files[r]);
    }
    return names;
  }

  std::string socket() const { return (folder_ / "pose.sock").string(); }
  /// Connects as soon as the socket is there.
  std::unique_ptr<StreamClient> connect(Format format) const {
    std::unique_ptr<StreamClient> client;
    const bool connected = eventually([&] {
      try {
        client = std::make_unique<StreamClient>(socket(), format);
        return true;
      } catch (const SetupError&) {
        return false;
      }
    });
    EXPECT_TRUE(connected) << "nobody listens at " << socket();
    return client;
  }
  /// Subscribes to poses and reads to the end.
  Received read_all(Format format) const {
    Received received;
    const auto client = connect(format);
    if (!client) return received;
    Subscription asked;
    asked.pose = true;
    client->subscribe(asked);
    ServerMessage message;
    for (StreamEvent event;
         (event = client->next(std::chrono::seconds(20), message)) == StreamEvent::message;) {
      received.raw.push_back(client->raw());
      if (const auto* pose = std::get_if<ReceivedPose>(&message)) received.frames.push_back(pose->frame);
      if (const auto* bye = std::get_if<Bye>(&message)) received.bye = bye->reason;
    }
    return received;
  }

  const fs::path folder_;
};

}  // namespace csipose::testing
