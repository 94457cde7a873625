#include "train/simulated_windows.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <cstring>
#include <fstream>
#include <memory>
#include <nlohmann/json.hpp>
#include <optional>
#include <vector>

#include "capture/front_end.h"
#include "capture/window_builder.h"
#include "proto/npy.h"
#include "proto/result.h"
#include "train/mapped_file.h"

namespace csipose::train {
namespace {

namespace fs = std::filesystem;

[[noreturn]] void refuse(const fs::path& path, const std::string& why) {
  throw SetupError(ExitStatus::bad_data, fmt::format("{}: {}", path.string(), why));
}

/// A mapped array whose rows have one shape.
class Rows {
 public:
  Rows(const fs::path& path, std::string_view descr, const NpyShape& row) : file_(path) {
    const Result<NpyView, std::string> view = parse_npy(file_.bytes());
    if (!view) refuse(path, view.error());
    if (view->descr != descr || view->fortran_order || view->shape.size() != row.size() + 1 ||
        NpyShape(view->shape.begin() + 1, view->shape.end()) != row)
      refuse(path, fmt::format("is no array of {} in rows of the shape that a simulated set has", descr));
    count_ = view->shape[0];
    data_ = view->data;
  }
  std::size_t count() const { return count_; }
  const std::uint8_t* row(std::size_t i) const { return data_.data() + i * (data_.size() / count_); }

 private:
  MappedFile file_;
  ByteView data_;
  std::size_t count_ = 0;
};

/// CSI of a set's snapshots, whatever it is kept as.
class Snapshots {
 public:
  virtual ~Snapshots() = default;
  virtual std::size_t rows() const = 0;
  /// nullopt: the receiver did not hear it.
  virtual std::optional<StreamCsi> read(std::size_t row, std::size_t t, std::size_t receiver) const = 0;
};

/// What the card reports: csi.npy [20][3][30][3][2] and received.npy [20][3].
class CardSnapshots : public Snapshots {
 public:
  explicit CardSnapshots(const fs::path& folder)
      : csi_(folder / "csi.npy", "|i1", {kSamples, kReceivers, kSubcarriers, kAntennas, 2}),
        received_(folder / "received.npy", "|u1", {kSamples, kReceivers}) {
    if (received_.count() != csi_.count()) refuse(folder / "received.npy", "has not as many rows as csi.npy");
  }
  std::size_t rows() const override { return csi_.count(); }
  std::optional<StreamCsi> read(std::size_t row, std::size_t t, std::size_t receiver) const override {
    if (received_.row(row)[t * kReceivers + receiver] == 0) return std::nullopt;
    constexpr std::size_t kNumbers = kSubcarriers * kAntennas * 2;
    std::array<std::int8_t, kNumbers> numbers;
    std::memcpy(numbers.data(), csi_.row(row) + (t * kReceivers + receiver) * kNumbers, kNumbers);
    StreamCsi h;
    for (std::size_t k = 0; k < kSubcarriers; ++k)
      for (std::size_t a = 0; a < kAntennas; ++a) {
        const std::size_t at = (k * kAntennas + a) * 2;
        h[a][k] = {static_cast<double>(numbers[at]), static_cast<double>(numbers[at + 1])};
      }
    return h;
  }

 private:
  Rows csi_, received_;
};

/// The channel before any radio: h.npy [20][30][3][3], snapshot, subcarrier, receiver, antenna.
class ChannelSnapshots : public Snapshots {
 public:
  explicit ChannelSnapshots(const fs::path& folder)
      : path_(folder / "h.npy"), h_(path_, "<c8", {kSamples, kSubcarriers, kReceivers, kAntennas}) {}
  std::size_t rows() const override { return h_.count(); }
  std::optional<StreamCsi> read(std::size_t row, std::size_t t, std::size_t receiver) const override {
    StreamCsi h;
    for (std::size_t k = 0; k < kSubcarriers; ++k)
      for (std::size_t a = 0; a < kAntennas; ++a) {
        std::complex<float> value;
        const std::size_t at = ((t * kSubcarriers + k) * kReceivers + receiver) * kAntennas + a;
        std::memcpy(&value, h_.row(row) + at * sizeof value, sizeof value);
        if (!std::isfinite(value.real()) || !std::isfinite(value.imag()))
          refuse(path_, fmt::format("row {} holds a number that is not finite", row));
        h[a][k] = std::complex<double>(value);
      }
    return h;
  }

 private:
  fs::path path_;
  Rows h_;
};

std::unique_ptr<Snapshots> open_snapshots(const fs::path& folder) {
  if (fs::exists(folder / "csi.npy")) return std::make_unique<CardSnapshots>(folder);
  if (fs::exists(folder / "h.npy") && !fs::exists(folder / "h_rms.npy"))
    return std::make_unique<ChannelSnapshots>(folder);
  throw SetupError(ExitStatus::bad_data,
                   fmt::format("{} has neither csi.npy (--store int8) nor a complex64 h.npy (--store "
                               "complex64); make the set with one of these",
                               folder.string()));
}

nlohmann::json read_plan(const fs::path& folder) {
  const fs::path path = folder / "dataset.json";
  std::ifstream file(path);
  if (!file)
    throw SetupError(ExitStatus::no_input,
                     fmt::format("{} cannot be read: {} is no finished simulated data set", path.string(),
                                 folder.string()));
  const nlohmann::json json = nlohmann::json::parse(file, nullptr, false);
  if (!json.is_object() || !json.contains("plan")) refuse(path, "is not JSON with a plan");
  return json["plan"];
}

/// Runs [first, last] of the split's clips; one run of all clips for "".
std::vector<std::pair<std::uint32_t, std::uint32_t>> clips_of(const nlohmann::json& plan,
                                                              const ConvertJob& job) {
  if (job.split.empty()) return {{0, UINT32_MAX}};
  const fs::path path = job.from / "dataset.json";
  try {
    const nlohmann::json& splits = plan.at("splits");
    if (!splits.contains(job.split)) refuse(path, fmt::format("has no split \"{}\"", job.split));
    return splits.at(job.split).get<std::vector<std::pair<std::uint32_t, std::uint32_t>>>();
  } catch (const nlohmann::json::exception&) {
    refuse(path, "its splits are not lists of [first clip, last clip]");
  }
}

double rate_hz(const nlohmann::json& plan, const fs::path& folder) {
  try {
    const double rate = std::stod(plan.at("made_by").at("rate_hz").get<std::string>());
    if (rate > 0 && rate <= 1e5) return rate;
  } catch (const std::exception&) {
  }
  refuse(folder / "dataset.json", "does not tell its rate_hz");
}

/// A clip's rows in order to windows: a stream of slots, 20 a row.
class ClipWindows {
 public:
  explicit ClipWindows(double grid_hz)
      : builder_({grid_hz, FrontEndConfig{}.max_gap, FrontEndConfig{}.max_skew}) {}

  const Window& next(const Snapshots& snapshots, std::size_t row) {
    for (std::size_t t = 0; t < kSamples; ++t, ++slot_)
      for (std::uint8_t r = 0; r < kReceivers; ++r)
        if (const std::optional<StreamCsi> h = snapshots.read(row, t, r)) put(r, *h);
    builder_.assemble(slot_ - 1, *window_);
    return *window_;
  }

 private:
  void put(std::uint8_t receiver, const StreamCsi& h) {
    Sample sample;
    sample.slot = sample.counter = slot_;
    sample.finite = true;
    sample.features = features_of(h, FrontEndConfig{}.phase, false, 1);
    builder_.put(receiver, sample);
  }

  WindowBuilder builder_;
  std::int64_t slot_ = 0;
  std::unique_ptr<Window> window_ = std::make_unique<Window>();
};

/// Copies the kept rows of an array that goes with the windows, where the set has it.
template <class T>
void copy_rows(const ConvertJob& job, const char* name, const std::vector<std::size_t>& kept,
               std::size_t rows) {
  if (!fs::exists(job.from / name)) return;
  const NpyArray<T> array = read_npy<T>(job.from / name);
  if (array.shape.empty() || array.shape[0] != rows) refuse(job.from / name, "has not one row a window");
  const std::size_t width = array.data.size() / rows;
  NpyWriter<T> writer(job.to / name, NpyShape(array.shape.begin() + 1, array.shape.end()));
  for (const std::size_t row : kept) writer.append(std::span(array.data).subspan(row * width, width));
  writer.finish();
}

void make_target(const fs::path& folder) {
  std::error_code error;
  fs::create_directories(folder, error);
  if (error)
    throw SetupError(ExitStatus::cannot_create,
                     fmt::format("{} cannot be made: {}", folder.string(), error.message()));
  if (fs::exists(folder / "windows.npy"))
    throw SetupError(ExitStatus::cannot_create,
                     fmt::format("{} holds windows already; name another folder", folder.string()));
}

}  // namespace

Converted convert_simulated(const ConvertJob& job) {
  const nlohmann::json plan = read_plan(job.from);
  const auto wanted = clips_of(plan, job);
  const double grid_hz = rate_hz(plan, job.from);
  const std::unique_ptr<Snapshots> snapshots = open_snapshots(job.from);
  const NpyArray<std::uint32_t> clips = read_npy<std::uint32_t>(job.from / "clip.npy");
  if (clips.shape != NpyShape{snapshots->rows()} || clips.data.empty())
    refuse(job.from / "clip.npy", fmt::format("has not one number for each of {} rows", snapshots->rows()));
  make_target(job.to);

  Converted converted;
  NpyWriter<float> windows(job.to / "windows.npy", {kChannels, kSamples, kLinks});
  std::vector<std::size_t> kept;
  std::optional<ClipWindows> clip;
  for (std::size_t row = 0; row < clips.data.size(); ++row) {
    const std::uint32_t number = clips.data[row];
    if (row == 0 || number != clips.data[row - 1]) clip.emplace(grid_hz);
    if (std::none_of(wanted.begin(), wanted.end(),
                     [&](const auto& run) { return run.first <= number && number <= run.second; }))
      continue;
    const Window& window = clip->next(*snapshots, row);
    if (!window.links.all()) {
      ++converted.incomplete;
      continue;
    }
    windows.append(window.x);
    kept.push_back(row);
  }
  if (kept.empty())
    throw SetupError(ExitStatus::bad_data, fmt::format("{}: no complete window in {}", job.from.string(),
                                                       job.split.empty() ? "the set" : "split " + job.split));
  converted.windows = kept.size();
  copy_rows<std::uint32_t>(job, "clip.npy", kept, clips.data.size());
  copy_rows<float>(job, "labels.npy", kept, clips.data.size());
  copy_rows<std::uint8_t>(job, "room.npy", kept, clips.data.size());
  windows.finish();
  return converted;
}

}  // namespace csipose::train
