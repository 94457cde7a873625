// csipose-sim record: a scene as three csitool logs, one per receiver.
#include <fmt/core.h>

#include <CLI/CLI.hpp>
#include <cstdio>
#include <memory>

#include "proto/result.h"
#include "sim/atomic_file.h"
#include "sim/commands.h"
#include "sim/receiver_log.h"
#include "sim/reflector.h"

namespace csipose::sim {
namespace {

struct RecordOptions {
  std::string scene = "reflector";
  std::filesystem::path folder;
  double seconds = 20, rate_hz = 300;
  std::uint64_t seed = 1;
  ImpairmentLevel level = ImpairmentLevel::intel5300;
};

void record(const RecordOptions& options) {
  make_folder(options.folder);
  const Band band;
  const ReflectorScene scene = default_reflector_scene(band);
  ReceiverBank bank(options.level, band, options.seed, /*clip=*/0, options.rate_hz);
  std::array<std::unique_ptr<AtomicFile>, kReceivers> files;
  for (std::size_t r = 0; r < kReceivers; ++r)
    files[r] = std::make_unique<AtomicFile>(options.folder / fmt::format("rx{}.dat", r + 1));

  std::array<std::vector<std::uint8_t>, kReceivers> logs;
  const auto packets = static_cast<std::uint32_t>(options.seconds * options.rate_hz);
  for (std::uint32_t p = 0; p < packets; ++p) {
    bank.send(reflector_channel(scene, band, p / options.rate_hz), logs);
    for (std::size_t r = 0; r < kReceivers; ++r) {
      files[r]->write(logs[r]);
      logs[r].clear();
    }
  }
  for (auto& file : files) file->commit();
  fmt::print("{} packets of {} s at {} a second, seed {}, in {}: rx1.dat rx2.dat rx3.dat\n", packets,
             options.seconds, options.rate_hz, options.seed, options.folder.string());
}

}  // namespace

void add_record(CLI::App& app) {
  auto options = std::make_shared<RecordOptions>();
  CLI::App* command =
      app.add_subcommand("record", "write a scene as three csitool logs: rx1.dat rx2.dat rx3.dat");
  command->add_option("--scene", options->scene, "reflector: line of sight and one point moving in a circle")
      ->check(CLI::IsMember({"reflector"}))
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
