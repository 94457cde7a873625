#include "train/simulated_set.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <cstring>
#include <fstream>
#include <glm/gtc/packing.hpp>
#include <nlohmann/json.hpp>

#include "proto/mapped_file.h"
#include "proto/npy.h"
#include "train/label_rows.h"
#include "train/refuse.h"
#include "train/snapshot_windows.h"

namespace csipose::train {
namespace {

namespace fs = std::filesystem;

/// A mapped array whose rows have one shape, but for their first size, the snapshots of a frame.
class Rows {
 public:
  Rows(const fs::path& path, std::string_view descr, const NpyShape& row) : file_(path) {
    const Result<NpyView, std::string> view = parse_npy(file_.bytes());
    if (!view) refuse(path, view.error());
    if (view->descr != descr || view->fortran_order || view->shape.size() != row.size() + 2 ||
        NpyShape(view->shape.begin() + 2, view->shape.end()) != row || view->shape[1] < 1 ||
        view->shape[1] > kSamples)
      refuse(path, fmt::format("is no array of {} in rows of the shape that a simulated set has", descr));
    count_ = view->shape[0];
    snapshots_ = view->shape[1];
    data_ = view->data;
  }
  std::size_t count() const { return count_; }
  std::size_t snapshots() const { return snapshots_; }
  const std::uint8_t* row(std::size_t i) const { return data_.data() + i * (data_.size() / count_); }

 private:
  MappedFile file_;
  ByteView data_;
  std::size_t count_ = 0, snapshots_ = 0;
};

/// CSI of a set's snapshots, whatever it is kept as.
class Snapshots {
 public:
  virtual ~Snapshots() = default;
  virtual std::size_t rows() const = 0;
  /// Of a row; t is less.
  virtual std::size_t snapshots() const = 0;
  /// nullopt: the receiver did not hear it.
  virtual std::optional<StreamCsi> read(std::size_t row, std::size_t t, std::size_t receiver) const = 0;
};

/// What the card reports: csi.npy [T][3][30][3][2] and received.npy [T][3].
class CardSnapshots : public Snapshots {
 public:
  explicit CardSnapshots(const fs::path& folder)
      : csi_(folder / "csi.npy", "|i1", {kReceivers, kSubcarriers, kAntennas, 2}),
        received_(folder / "received.npy", "|u1", {kReceivers}) {
    if (received_.count() != csi_.count() || received_.snapshots() != csi_.snapshots())
      refuse(folder / "received.npy", "has not as many rows and snapshots as csi.npy");
  }
  std::size_t rows() const override { return csi_.count(); }
  std::size_t snapshots() const override { return csi_.snapshots(); }
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

/// The channel before any radio: h.npy [T][30][3][3], snapshot, subcarrier, receiver, antenna.
class ChannelSnapshots : public Snapshots {
 public:
  explicit ChannelSnapshots(const fs::path& folder)
      : ChannelSnapshots(folder, "<c8", {kSubcarriers, kReceivers, kAntennas}) {}
  std::size_t rows() const override { return h_.count(); }
  std::size_t snapshots() const override { return h_.snapshots(); }
  std::optional<StreamCsi> read(std::size_t row, std::size_t t, std::size_t receiver) const override {
    StreamCsi h;
    for (std::size_t k = 0; k < kSubcarriers; ++k)
      for (std::size_t a = 0; a < kAntennas; ++a) {
        const std::complex<float> value =
            number(row, ((t * kSubcarriers + k) * kReceivers + receiver) * kAntennas + a);
        if (!std::isfinite(value.real()) || !std::isfinite(value.imag()))
          refuse(path_, fmt::format("row {} holds a number that is not finite", row));
        h[a][k] = std::complex<double>(value);
      }
    return h;
  }

 protected:
  ChannelSnapshots(const fs::path& folder, std::string_view descr, const NpyShape& row)
      : path_(folder / "h.npy"), h_(path_, descr, row) {}
  template <class T>
  T at(std::size_t row, std::size_t i) const {
    T value;
    std::memcpy(&value, h_.row(row) + i * sizeof value, sizeof value);
    return value;
  }

 private:
  virtual std::complex<float> number(std::size_t row, std::size_t i) const {
    return at<std::complex<float>>(row, i);
  }

  fs::path path_;
  Rows h_;
};

/// The same as pairs of float16, over each row's rms.
class HalfSnapshots final : public ChannelSnapshots {
 public:
  explicit HalfSnapshots(const fs::path& folder)
      : ChannelSnapshots(folder, "<f2", {kSubcarriers, kReceivers, kAntennas, 2}),
        rms_(read_npy<float>(folder / "h_rms.npy")) {
    if (rms_.shape != NpyShape{rows()})
      refuse(folder / "h_rms.npy", "has not one number for each row of h.npy");
  }

 private:
  std::complex<float> number(std::size_t row, std::size_t i) const override {
    const auto pair = at<std::array<std::uint16_t, 2>>(row, i);
    return rms_.data[row] * std::complex<float>(glm::unpackHalf1x16(pair[0]), glm::unpackHalf1x16(pair[1]));
  }

  NpyArray<float> rms_;
};

std::unique_ptr<Snapshots> open_snapshots(const fs::path& folder) {
  if (fs::exists(folder / "csi.npy")) return std::make_unique<CardSnapshots>(folder);
  if (fs::exists(folder / "h_rms.npy")) return std::make_unique<HalfSnapshots>(folder);
  if (fs::exists(folder / "h.npy")) return std::make_unique<ChannelSnapshots>(folder);
  refuse(folder, "has neither csi.npy nor h.npy: it lacks the channel");
}

/// dataset.json, which has a plan.
nlohmann::json read_description(const fs::path& folder) {
  const fs::path path = folder / "dataset.json";
  std::ifstream file(path);
  if (!file)
    throw SetupError(ExitStatus::no_input,
                     fmt::format("{} cannot be read: {} is no finished simulated data set", path.string(),
                                 folder.string()));
  nlohmann::json json = nlohmann::json::parse(file, nullptr, false);
  if (!json.is_object() || !json.contains("plan")) refuse(path, "is not JSON with a plan");
  return json;
}

/// By the digest of the channel: the same only for the same set. Empty where dataset.json has none.
std::string clips_name(const nlohmann::json& description) {
  const nlohmann::json digests = description.value("sha256", nlohmann::json::object());
  for (const char* array : {"csi.npy", "h.npy"})
    if (digests.is_object() && digests.contains(array) && digests[array].is_string())
      return fmt::format("simulated {:.16}", digests[array].get<std::string>());
  return {};
}

/// Runs [first, last] of clips.
using ClipRuns = std::vector<std::pair<std::uint32_t, std::uint32_t>>;

/// Those of a split; one run of all clips for "".
ClipRuns clips_of(const nlohmann::json& plan, const fs::path& folder, const std::string& split) {
  if (split.empty()) return {{0, UINT32_MAX}};
  const fs::path path = folder / "dataset.json";
  try {
    const nlohmann::json& splits = plan.at("splits");
    if (!splits.contains(split)) refuse(path, fmt::format("has no split \"{}\"", split));
    return splits.at(split).get<ClipRuns>();
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

std::map<std::uint8_t, std::string> room_names(const nlohmann::json& plan) {
  std::map<std::uint8_t, std::string> names;
  try {
    for (const nlohmann::json& name : plan.at("names").at("room"))
      names[static_cast<std::uint8_t>(names.size())] = name.get<std::string>();
  } catch (const nlohmann::json::exception&) {
    return {};  // a set without rooms, or whose rooms have no names
  }
  return names;
}

class SimulatedSet final : public DataSet {
 public:
  /// description: as read_description(folder) gives it.
  SimulatedSet(const fs::path& folder, const std::string& split, const nlohmann::json& description)
      : folder_(folder),
        split_(split),
        plan_(description.at("plan")),
        wanted_(clips_of(plan_, folder, split)),
        snapshots_(open_snapshots(folder)) {
    about_ = {"simulated", fs::exists(folder / "labels.npy"), room_names(plan_), snapshots_->snapshots(),
              clips_name(description)};
  }
  const SetAbout& about() const override { return about_; }

  LeftOut read(const WindowSink& sink, const Warn&) const override {
    const double grid_hz = rate_hz(plan_, folder_);
    const std::size_t rows = snapshots_->rows();
    const auto clips = array<std::uint32_t>("clip.npy", rows);
    const auto rooms =
        fs::exists(folder_ / "room.npy") ? array<std::uint8_t>("room.npy", rows) : NpyArray<std::uint8_t>{};
    const auto labels = about_.labelled ? array<float>("labels.npy", rows) : NpyArray<float>{};
    if (about_.labelled && (labels.shape.size() != 4 || labels.shape[2] != kJoints || labels.shape[3] != 3))
      refuse(folder_ / "labels.npy", fmt::format("is no array of shape ({}, people, 14, 3)", rows));

    LeftOut left_out;
    std::size_t given = 0;
    std::optional<SnapshotWindows> stream;
    for (std::size_t row = 0; row < rows; ++row) {
      if (row == 0 || clips.data[row] != clips.data[row - 1]) stream.emplace(grid_hz);
      if (!is_wanted(clips.data[row])) continue;
      const Window& window = next(*stream, *snapshots_, row);
      if (!window.links.all()) {
        ++left_out.incomplete;
        continue;
      }
      const std::vector<Skeleton> people = people_of(labels, row);
      LabelledWindow given_window{window.x, clips.data[row], {}, people};
      if (!rooms.data.empty()) given_window.room = rooms.data[row];
      sink(given_window);
      ++given;
    }
    if (given == 0)
      throw SetupError(ExitStatus::bad_data, fmt::format("{}: no complete window in {}", folder_.string(),
                                                         split_.empty() ? "the set" : "split " + split_));
    return left_out;
  }

 private:
  template <class T>
  NpyArray<T> array(const char* name, std::size_t rows) const {
    NpyArray<T> read = read_npy<T>(folder_ / name);
    const bool numbers = kNpyType<T> != kNpyType<float>;  // labels have more dimensions
    if (read.shape.empty() || read.shape[0] != rows || rows == 0 || (numbers && read.shape.size() != 1))
      refuse(folder_ / name,
             fmt::format("has not one {} for each of {} rows", numbers ? "number" : "row", rows));
    return read;
  }
  bool is_wanted(std::uint32_t clip) const {
    return std::ranges::any_of(wanted_,
                               [&](const auto& run) { return run.first <= clip && clip <= run.second; });
  }
  static const Window& next(SnapshotWindows& stream, const Snapshots& snapshots, std::size_t row) {
    for (std::size_t t = 0; t < kSamples; ++t)
      for (std::uint8_t r = 0; r < kReceivers; ++r)
        if (const std::optional<StreamCsi> h = snapshots.read(row, t % snapshots.snapshots(), r))
          stream.put(t, r, *h);
    return stream.next();
  }
  std::vector<Skeleton> people_of(const NpyArray<float>& labels, std::size_t row) const {
    if (labels.data.empty()) return {};
    const std::size_t width = labels.shape[1] * kPoseWidth;
    auto people = people_of_row(std::span(labels.data).subspan(row * width, width));
    if (!people)
      refuse(folder_ / "labels.npy",
             fmt::format("row {} has a person of whom some joints are no numbers", row));
    return std::move(*people);
  }

  fs::path folder_;
  std::string split_;
  nlohmann::json plan_;
  ClipRuns wanted_;
  std::unique_ptr<const Snapshots> snapshots_;
  SetAbout about_;
};

}  // namespace

std::unique_ptr<const DataSet> open_simulated_set(const fs::path& folder, const std::string& split) {
  return std::make_unique<SimulatedSet>(folder, split, read_description(folder));
}

std::vector<std::string> splits_of_simulated_set(const fs::path& folder) {
  const nlohmann::json plan = read_description(folder)["plan"];
  std::vector<std::string> names;
  if (plan.contains("splits") && plan["splits"].is_object())
    for (const auto& [name, runs] : plan["splits"].items()) names.push_back(name);
  return names;
}

}  // namespace csipose::train
