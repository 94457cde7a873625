// csipose-sim record: a scene as three csitool logs, one per receiver.
#include <fmt/core.h>

#include <CLI/CLI.hpp>
#include <cstdio>
#include <memory>

#include "proto/npy.h"
#include "proto/result.h"
#include "sim/atomic_file.h"
#include "sim/commands.h"
#include "sim/receiver_log.h"
#include "sim/scene_options.h"

namespace csipose::sim {
namespace {

struct RecordOptions {
  SceneOptions scene;
  RadioOptions radio;
  std::filesystem::path folder;
  double seconds = 20;
};

using Logs = std::array<std::vector<std::uint8_t>, kReceivers>;

/// The three logs, and beside them where people were, if the scene has any.
class Output {
 public:
  Output(const std::filesystem::path& folder, std::size_t people) {
    for (std::size_t r = 0; r < kReceivers; ++r)
      files_[r] = std::make_unique<AtomicFile>(folder / fmt::format("rx{}.dat", r + 1));
    if (people > 0)
      truth_ = std::make_unique<NpyWriter<float>>(folder / "truth.npy", NpyShape{people, kJoints, 3});
  }
  void write(Logs& logs, const std::vector<Joints>& people) {
    for (std::size_t r = 0; r < kReceivers; ++r) {
      files_[r]->write(logs[r]);
      logs[r].clear();
    }
    row_.clear();
    for (const auto& person : people)
      for (const Vec3& joint : person)
        for (int axis = 0; axis < 3; ++axis) row_.push_back(static_cast<float>(joint[axis]));
    if (truth_) truth_->append(row_);
  }
  void finish() {
    for (auto& file : files_) file->commit();
    if (truth_) truth_->finish();
  }

 private:
  std::array<std::unique_ptr<AtomicFile>, kReceivers> files_;
  std::unique_ptr<NpyWriter<float>> truth_;
  std::vector<float> row_;
};

void record(const RecordOptions& options) {
  make_folder(options.folder);
  const auto channels = open_channels(options.scene);
  ReceiverBank bank(options.radio.impairments(), Band{}, options.scene.seed, options.scene.clip,
                    options.scene.rate_hz);
  Output output(options.folder, channels->people());
  const auto packets = static_cast<std::uint32_t>(options.seconds * options.scene.rate_hz);
  Logs logs;
  for (std::uint32_t p = 0; p < packets; ++p) {
    const Instant& now = channels->next();
    bank.send(now.channel, logs);
    output.write(logs, now.people);
  }
  output.finish();
  fmt::print("{} packets of {} s at {} a second, seed {}, in {}: rx1.dat rx2.dat rx3.dat{}\n", packets,
             options.seconds, options.scene.rate_hz, options.scene.seed, options.folder.string(),
             channels->people() > 0 ? " truth.npy" : "");
}

}  // namespace

void add_record(CLI::App& app) {
  auto options = std::make_shared<RecordOptions>();
  CLI::App* command =
      app.add_subcommand("record", "write a scene as three csitool logs: rx1.dat rx2.dat rx3.dat");
  add_scene_options(*command, options->scene);
  add_radio_options(*command, options->radio);
  command->add_option("--out", options->folder, "folder for the logs; made when missing")->required();
  command->add_option("--seconds", options->seconds, "length")
      ->check(CLI::Range(0.01, 86400.0))
      ->capture_default_str();
  command->callback([options] { record(*options); });
}

}  // namespace csipose::sim
