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
#include "sim/solved_scene.h"
#include "sim/walking_scene.h"

namespace csipose::sim {
namespace {

struct RecordOptions {
  std::string scene = "reflector";
  std::filesystem::path folder;
  double seconds = 20, rate_hz = 300;
  std::uint64_t seed = 1;
  ImpairmentLevel level = ImpairmentLevel::intel5300;
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
  const auto scene = options.scene == "walk" ? solve_as_it_moves(walking_scene(options.rate_hz))
                                             : reflector_channels(options.rate_hz);
  ReceiverBank bank(options.level, Band{}, options.seed, /*clip=*/0, options.rate_hz);
  Output output(options.folder, scene->people());
  const auto packets = static_cast<std::uint32_t>(options.seconds * options.rate_hz);
  Logs logs;
  for (std::uint32_t p = 0; p < packets; ++p) {
    const Instant& now = scene->next();
    bank.send(now.channel, logs);
    output.write(logs, now.people);
  }
  output.finish();
  fmt::print("{} packets of {} s at {} a second, seed {}, in {}: rx1.dat rx2.dat rx3.dat{}\n", packets,
             options.seconds, options.rate_hz, options.seed, options.folder.string(),
             scene->people() > 0 ? " truth.npy" : "");
}

}  // namespace

void add_record(CLI::App& app) {
  auto options = std::make_shared<RecordOptions>();
  CLI::App* command =
      app.add_subcommand("record", "write a scene as three csitool logs: rx1.dat rx2.dat rx3.dat");
  command
      ->add_option("--scene", options->scene,
                   "reflector: line of sight and one point moving in a circle; walk: a person walking round "
                   "a room, with truth.npy")
      ->check(CLI::IsMember({"reflector", "walk"}))
      ->capture_default_str();
  command->add_option("--out", options->folder, "folder for the logs; made when missing")->required();
  command->add_option("--seconds", options->seconds, "length")
      ->check(CLI::Range(0.01, 86400.0))
      ->capture_default_str();
  command->add_option("--rate", options->rate_hz, "packets a second")
      ->check(CLI::Range(1.0, 10000.0))
      ->capture_default_str();
  command->add_option("--seed", options->seed, "same seed, same bytes")->capture_default_str();
  const std::map<std::string, ImpairmentLevel> levels{
      {"none", ImpairmentLevel::none}, {"mild", ImpairmentLevel::mild}, {"5300", ImpairmentLevel::intel5300}};
  command->add_option("--impair", options->level, "what the radio spoils: none, mild or 5300 (default)")
      ->transform(CLI::CheckedTransformer(levels));
  command->callback([options] { record(*options); });
}

}  // namespace csipose::sim
