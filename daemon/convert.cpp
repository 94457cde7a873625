#include "daemon/convert.h"

#include <fmt/format.h>
#include <unistd.h>

#include <limits>

#include "capture/replay.h"
#include "daemon/log_file.h"
#include "proto/intel5300.h"
#include "proto/npy.h"
#include "proto/recording.h"
#include "version.h"

namespace csipose {
namespace {

namespace fs = std::filesystem;

constexpr std::size_t kFieldColumns = 18;

void make_folder(const fs::path& folder) {
  std::error_code error;
  fs::create_directories(folder, error);
  if (error)
    throw SetupError(ExitStatus::cannot_create,
                     fmt::format("cannot make the folder {}: {}.", folder.string(), error.message()));
}

/// The records of one receiver that decode.
using RecordVisitor = std::function<void(const CsiRecord&, const RawRecord&)>;
void for_each_csi(const LogFile& log, std::size_t receiver, const RecordVisitor& visit) {
  log.for_each(receiver, RecordStream::Policy::resynchronising, [&](const LogRecord& entry) {
    CsiRecord record;
    if (entry.raw.code == kCsiCode && !decode_bfee(entry.raw.body, record)) visit(record, entry.raw);
  });
}

/// fields.npy, csi_raw.npy, csi_scaled.npy, csi_scaled_sm.npy.
class RawArrays {
 public:
  RawArrays(const fs::path& folder, std::size_t streams, bool has_offsets)
      : streams_(streams),
        has_offsets_(has_offsets),
        fields_(folder / "fields.npy", {kFieldColumns}),
        raw_(folder / "csi_raw.npy", {kSubcarriers, kAntennas, streams, 2}),
        scaled_(folder / "csi_scaled.npy", {kSubcarriers, kAntennas, streams}),
        channel_(kCsiRows * streams) {
    if (streams > 1)
      unmapped_.emplace(folder / "csi_scaled_sm.npy", NpyShape{kSubcarriers, kAntennas, streams});
  }
  void add(const CsiRecord& record, const RawRecord& raw) {
    add_fields(record, raw);
    add_raw(record);
    add_scaled(scale_csi, record, scaled_);
    if (unmapped_) add_scaled(scale_csi_without_mapping, record, *unmapped_);
  }
  void finish() {
    fields_.finish();
    raw_.finish();
    scaled_.finish();
    if (unmapped_) unmapped_->finish();
  }

 private:
  void add_fields(const CsiRecord& r, const RawRecord& raw) {
    const std::array<std::int64_t, kFieldColumns> row = {
        has_offsets_ ? static_cast<std::int64_t>(raw.offset) : -1,
        static_cast<std::int64_t>(raw.body.size() + 1),
        r.timestamp_low,
        r.bfee_count,
        r.nrx,
        r.ntx,
        r.rssi[0],
        r.rssi[1],
        r.rssi[2],
        r.noise_dbm,
        r.agc_db,
        r.antenna_sel,
        r.payload_length,
        r.rate,
        r.perm[0],
        r.perm[1],
        r.perm[2],
        r.perm_valid};
    fields_.append(row);
  }
  void add_raw(const CsiRecord& record) {
    counts_.clear();
    for (std::size_t i = 0; i < record.csi.size(); i += kMaxStreams * 2)
      counts_.insert(counts_.end(), record.csi.begin() + i, record.csi.begin() + i + streams_ * 2);
    raw_.append(counts_);
  }
  void add_scaled(bool (*scale)(const CsiRecord&, CsiMatrix), const CsiRecord& record,
                  NpyWriter<std::complex<float>>& file) {
    constexpr float kNan = std::numeric_limits<float>::quiet_NaN();
    if (!scale(record, channel_))
      std::fill(channel_.begin(), channel_.end(), std::complex<float>(kNan, kNan));
    file.append(channel_);
  }

  std::size_t streams_;
  bool has_offsets_;
  NpyWriter<std::int64_t> fields_;
  NpyWriter<std::int8_t> raw_;
  NpyWriter<std::complex<float>> scaled_;
  std::optional<NpyWriter<std::complex<float>>> unmapped_;
  std::vector<std::int8_t> counts_;
  std::vector<std::complex<float>> channel_;
};

/// phase_METHOD.npy, phase_mask.npy.
class PhaseArrays {
 public:
  PhaseArrays(const fs::path& folder, const ConvertOptions& options)
      : options_(options),
        phase_(folder / (is_joint() ? "phase_joint.npy" : "phase_phasefi.npy"), {kAntennas, kSubcarriers}),
        mask_(folder / "phase_mask.npy", {kAntennas, kSubcarriers}) {}
  void add(const CsiRecord& record) {
    std::array<std::uint8_t, kCsiRows> mask{};
    StreamPhase phase{};
    if (is_defined(record)) {
      const StreamCsi h =
          stream_csi(record, static_cast<std::size_t>(options_.stream), options_.undo_40mhz_rotation);
      phase = is_joint() ? sanitise_joint(h) : sanitise_phasefi(h, record.is_40mhz());
      for (std::size_t i = 0; i < kCsiRows; ++i) mask[i] = h[i / kSubcarriers][i % kSubcarriers] != 0.0;
    }
    phase_.append({phase.front().data(), kCsiRows});
    mask_.append(mask);
  }
  void finish() {
    phase_.finish();
    mask_.finish();
  }

 private:
  bool is_joint() const { return *options_.phase == PhaseMethod::joint; }
  bool is_defined(const CsiRecord& record) const {
    return options_.stream < record.ntx && (is_joint() ? record.usable() : record.perm_valid);
  }
  ConvertOptions options_;
  NpyWriter<double> phase_;
  NpyWriter<std::uint8_t> mask_;
};

void convert_receiver(const LogFile& log, std::size_t receiver, const std::string& file,
                      const fs::path& folder, const ConvertOptions& options) {
  std::size_t streams = 0;
  for_each_csi(log, receiver, [&](const CsiRecord& record, const RawRecord&) {
    streams = std::max<std::size_t>(streams, record.ntx);
  });
  if (streams == 0)
    throw SetupError(
        ExitStatus::bad_data,
        fmt::format("cannot convert {}: no CSI record in it decodes; `csipose inspect` tells more.", file));
  make_folder(folder);
  RawArrays raw(folder, streams, !log.is_recording());
  std::optional<PhaseArrays> phases;
  if (options.phase) phases.emplace(folder, options);
  for_each_csi(log, receiver, [&](const CsiRecord& record, const RawRecord& bytes) {
    raw.add(record, bytes);
    if (phases) phases->add(record);
  });
  raw.finish();
  if (phases) phases->finish();
}

/// The files of windows.
class WindowArrays {
 public:
  explicit WindowArrays(const fs::path& folder)
      : x_(folder / "tensor.npy", {kChannels, kSamples, kLinks}),
        links_(folder / "tensor_links.npy", {kLinks}),
        samples_(folder / "tensor_samples.npy", {kSamples, kReceivers}),
        time_ns_(folder / "tensor_time_ns.npy", {2}),
        slot_(folder / "tensor_slot.npy", {}) {}
  void add(const Window& window) {
    x_.append(window.x);
    std::array<std::uint8_t, kLinks> links;
    for (std::size_t l = 0; l < kLinks; ++l) links[l] = window.links[l];
    links_.append(links);
    std::array<std::uint8_t, kSamples * kReceivers> samples;
    for (std::size_t i = 0; i < samples.size(); ++i)
      samples[i] = static_cast<std::uint8_t>(window.samples[i / kReceivers][i % kReceivers]);
    samples_.append(samples);
    time_ns_.append(std::array{ns(window.first_sample_utc), ns(window.last_sample_utc)});
    slot_.append(std::array{window.end_slot});
  }
  std::size_t count() const { return slot_.rows(); }
  void finish() {
    x_.finish();
    links_.finish();
    samples_.finish();
    time_ns_.finish();
    slot_.finish();
  }

 private:
  NpyWriter<float> x_;
  NpyWriter<std::uint8_t> links_, samples_;
  NpyWriter<std::int64_t> time_ns_, slot_;
};

std::unique_ptr<PacketSource> open_files(const std::vector<std::string>& files, double rate_hz) {
  return open_replay({.files = files, .rate_hz = rate_hz, .loop = false});
}

}  // namespace

void convert_to_npy(const std::string& file, const fs::path& folder, const ConvertOptions& options) {
  const std::unique_ptr<LogFile> log = open_log(file);
  const std::vector<std::string> receivers = log->receivers();
  if (receivers.empty())
    throw SetupError(ExitStatus::bad_data,
                     fmt::format("cannot convert {}: it holds no receiver's records.", file));
  for (std::size_t i = 0; i < receivers.size(); ++i)
    convert_receiver(*log, i, file, log->is_recording() ? folder / receivers[i] : folder, options);
}

std::size_t convert_to_tensor(const std::vector<std::string>& files, const fs::path& folder,
                              const TensorOptions& options) {
  FrontEnd front_end(options.front_end);
  make_folder(folder);
  WindowArrays arrays(folder);
  for_each_window(*open_files(files, options.rate_hz), front_end, options.jitter,
                  [&](const Window& window) { arrays.add(window); });
  if (arrays.count() == 0)
    throw SetupError(
        ExitStatus::bad_data,
        fmt::format(
            "cannot make windows of {}: too few usable records for one; `csipose inspect` tells more.",
            files.front()));
  arrays.finish();
  return arrays.count();
}

std::uint64_t convert_to_recording(const std::vector<std::string>& files, const std::string& recording,
                                   double rate_hz) {
  if (fs::exists(recording))
    throw SetupError(ExitStatus::cannot_create,
                     fmt::format("{} is there already; remove it or name another file.", recording));
  const std::string unfinished = fmt::format("{}.part{}", recording, ::getpid());
  std::uint64_t packets = 0;
  try {
    RecordingWriter writer(unfinished, {.source = Source::replay, .software = "csipose " CSIPOSE_VERSION},
                           {});
    const auto refused = [&] {
      return SetupError(ExitStatus::io, fmt::format("cannot write {}: {}", recording, writer.error()));
    };
    for_each_packet(*open_files(files, rate_hz), [&](const Packet& packet) {
      if (!writer.add(packet)) throw refused();
      ++packets;
    });
    if (!writer.close()) throw refused();
    fs::rename(unfinished, recording);
  } catch (...) {
    std::error_code ignored;  // the first error is the one to tell
    fs::remove(unfinished, ignored);
    throw;
  }
  return packets;
}

}  // namespace csipose
