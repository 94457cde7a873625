// csipose-sim record: a scene as three csitool logs, one per receiver, or as one recording.
#include <fmt/core.h>

#include <CLI/CLI.hpp>
#include <cstdio>
#include <memory>

#include "proto/npy.h"
#include "proto/recording.h"
#include "proto/result.h"
#include "sim/atomic_file.h"
#include "sim/commands.h"
#include "sim/packet_feed.h"
#include "sim/scene_options.h"
#include "version.h"

namespace csipose::sim {
namespace {
namespace fs = std::filesystem;

struct RecordOptions {
  SceneOptions scene;
  RadioOptions radio;
  fs::path out;
  double seconds = 20;
};

/// Where packets go.
class Output {
 public:
  virtual ~Output() = default;
  virtual void write(const SentPacket& packet) = 0;
  virtual void finish() = 0;
};

/// Three csitool logs, and beside them where people were, if the scene has any.
class Logs final : public Output {
 public:
  Logs(const fs::path& folder, std::size_t people) {
    make_folder(folder);
    for (std::size_t r = 0; r < kReceivers; ++r)
      files_[r] = std::make_unique<AtomicFile>(folder / fmt::format("rx{}.dat", r + 1));
    if (people > 0)
      truth_ = std::make_unique<NpyWriter<float>>(folder / "truth.npy", NpyShape{people, kJoints, 3});
  }
  void write(const SentPacket& packet) override {
    for (std::size_t r = 0; r < kReceivers; ++r) files_[r]->write(packet.records[r]);
    row_.clear();
    for (const auto& person : packet.people)
      for (const Vec3& joint : person)
        for (int axis = 0; axis < 3; ++axis) row_.push_back(static_cast<float>(joint[axis]));
    if (truth_) truth_->append(row_);
  }
  void finish() override {
    for (auto& file : files_) file->commit();
    if (truth_) truth_->finish();
  }

 private:
  std::array<std::unique_ptr<AtomicFile>, kReceivers> files_;
  std::unique_ptr<NpyWriter<float>> truth_;
  std::vector<float> row_;
};

/// One recording with the truth as a channel. Its clock begins at 0: the same command writes the same bytes.
class Recording final : public Output {
 public:
  explicit Recording(const fs::path& file) : file_(file), part_(file.string() + ".part") {
    if (file.has_parent_path()) make_folder(file.parent_path());
    fs::remove(part_);
    RecordingInfo info;
    info.source = Source::simulated;
    info.software = "csipose-sim " CSIPOSE_VERSION;
    writer_ = std::make_unique<RecordingWriter>(part_.string(), info, ByteView{});
  }
  ~Recording() override {
    std::error_code ignored;
    fs::remove(part_, ignored);
  }
  void write(const SentPacket& packet) override {
    const Nanoseconds sent(static_cast<std::int64_t>(packet.sent_s * 1e9));
    for (std::size_t r = 0; r < kReceivers; ++r)
      if (!packet.records[r].empty())
        check(writer_->add(
            Packet{static_cast<std::uint8_t>(r), SteadyTime(sent), UtcTime(sent), packet.records[r]}));
    if (packet.people.empty()) return;
    std::string line = encode(truth_of(packet, UtcTime(sent)));
    line.pop_back();  // the newline
    check(writer_->add(TruthItem{line, packet.counter, SteadyTime(sent), UtcTime(sent)}));
  }
  void finish() override {
    check(writer_->close());
    std::error_code error;
    fs::rename(part_, file_, error);
    if (error)
      throw SetupError(ExitStatus::io,
                       fmt::format("cannot name the recording {}: {}", file_.string(), error.message()));
  }

 private:
  void check(bool written) const {
    if (!written)
      throw SetupError(ExitStatus::io, fmt::format("cannot write {}: {}", file_.string(), writer_->error()));
  }
  fs::path file_, part_;
  std::unique_ptr<RecordingWriter> writer_;
};

void record(const RecordOptions& options) {
  const auto channels = open_channels(options.scene);
  const std::size_t people = channels->people();
  std::unique_ptr<Output> output;
  const bool mcap = options.out.extension() == ".mcap";
  if (mcap)
    output = std::make_unique<Recording>(options.out);
  else
    output = std::make_unique<Logs>(options.out, people);
  ReceiverBank bank(options.radio.impairments(), Band{}, options.scene.seed, options.scene.clip,
                    options.scene.rate_hz);
  const auto packets = static_cast<std::uint32_t>(options.seconds * options.scene.rate_hz);
  SentPacket packet;
  for (std::uint32_t p = 0; p < packets; ++p) {
    send_packet(*channels, bank, options.scene.rate_hz, packet);
    output->write(packet);
  }
  output->finish();
  fmt::print("{} packets of {} s at {} a second, seed {}, in {}{}{}\n", packets, options.seconds,
             options.scene.rate_hz, options.scene.seed, options.out.string(),
             mcap ? "" : ": rx1.dat rx2.dat rx3.dat",
             people == 0 ? ""
             : mcap      ? ", with the truth"
                         : " truth.npy");
}

}  // namespace

void add_record(CLI::App& app) {
  auto options = std::make_shared<RecordOptions>();
  CLI::App* command = app.add_subcommand("record", "write a scene as three csitool logs or as one recording");
  add_scene_options(*command, options->scene);
  add_radio_options(*command, options->radio);
  command
      ->add_option("--out", options->out,
                   "NAME.mcap: one recording, with the truth; else a folder, made when missing, for rx1.dat "
                   "rx2.dat rx3.dat and truth.npy")
      ->required();
  command->add_option("--seconds", options->seconds, "length")
      ->check(CLI::Range(0.01, 86400.0))
      ->capture_default_str();
  command->callback([options] { record(*options); });
}

}  // namespace csipose::sim
