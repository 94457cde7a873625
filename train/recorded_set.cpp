#include "train/recorded_set.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>

#include "capture/recorded_windows.h"
#include "capture/replay.h"
#include "proto/mapped_file.h"
#include "proto/npy.h"
#include "proto/truth_reader.h"
#include "train/label_rows.h"
#include "train/refuse.h"

namespace csipose::train {
namespace {

namespace fs = std::filesystem;

/// Slots from the newest snapshot back to the one that labels belong to.
constexpr std::int64_t kLabelBack = kSamples - 1 - 10;

using People = std::vector<Skeleton>;

/// Who is where in a window.
class TruthOf {
 public:
  virtual ~TruthOf() = default;
  /// nullptr: the recording does not say.
  virtual const People* at(const Window& window, const FrontEnd& front_end) const = 0;
};

/// Channel /truth.
class RecordedTruth final : public TruthOf {
 public:
  RecordedTruth(const fs::path& path, double grid_hz) : grid_step_(from_seconds(1 / grid_hz)) {
    const MappedFile file(path);
    TruthReader reader(file.bytes(), path.string());
    while (const std::optional<Truth> truth = reader.next()) {
      People people;
      for (const TruePerson& person : truth->people) people.push_back(person.joints);
      instants_.push_back({ns(truth->sent), std::move(people)});
    }
    std::ranges::stable_sort(instants_, {}, &Instant::utc_ns);
  }
  bool empty() const { return instants_.empty(); }

  const People* at(const Window& window, const FrontEnd&) const override {
    const std::int64_t wanted = ns(window.last_sample_utc - kLabelBack * grid_step_);
    const auto after = std::ranges::lower_bound(instants_, wanted, {}, &Instant::utc_ns);
    const Instant* nearest = nullptr;
    for (auto near = after == instants_.begin() ? after : after - 1; near != instants_.end() && near <= after;
         ++near)
      if (nearest == nullptr || std::abs(near->utc_ns - wanted) < std::abs(nearest->utc_ns - wanted))
        nearest = &*near;
    if (nearest == nullptr || std::abs(nearest->utc_ns - wanted) > step_ns()) return nullptr;
    return &nearest->people;
  }

 private:
  struct Instant {
    std::int64_t utc_ns;
    People people;
  };
  /// Between two packets.
  std::int64_t step_ns() const {
    const auto count = static_cast<std::int64_t>(instants_.size());
    const std::int64_t usual =
        count < 2 ? 0 : (instants_.back().utc_ns - instants_.front().utc_ns) / (count - 1);
    return std::max(usual, ns(grid_step_));
  }

  Nanoseconds grid_step_;
  std::vector<Instant> instants_;  // ascending
};

/// truth.npy, a row a packet.
class TruthRows final : public TruthOf {
 public:
  TruthRows(const fs::path& path, double grid_hz) : grid_hz_(grid_hz) {
    const NpyArray<float> rows = read_npy<float>(path);
    if (rows.shape.size() != 4 || rows.shape[2] != kJoints || rows.shape[3] != 3)
      refuse(path, "is no array of shape (packets, people, 14, 3)");
    const std::size_t width = rows.shape[1] * kPoseWidth;
    for (std::size_t row = 0; row < rows.shape[0]; ++row) {
      auto people = people_of_row(std::span(rows.data).subspan(row * width, width));
      if (!people) refuse(path, fmt::format("row {} has a person of whom some joints are no numbers", row));
      rows_.push_back(std::move(*people));
    }
  }
  const People* at(const Window& window, const FrontEnd& front_end) const override {
    const double packet =
        std::round(static_cast<double>(window.end_slot - kLabelBack) * front_end.stats().tx_hz / grid_hz_);
    if (packet < 0 || packet >= static_cast<double>(rows_.size())) return nullptr;
    return &rows_[static_cast<std::size_t>(packet)];
  }

 private:
  double grid_hz_;
  std::vector<People> rows_;
};

std::unique_ptr<const TruthOf> open_truth(const fs::path& from, double grid_hz) {
  if (fs::is_directory(from)) {
    if (!fs::exists(from / "truth.npy")) return nullptr;
    return std::make_unique<TruthRows>(from / "truth.npy", grid_hz);
  }
  auto truth = std::make_unique<RecordedTruth>(from, grid_hz);
  if (truth->empty()) return nullptr;
  return truth;
}

std::vector<std::string> files_of(const fs::path& from) {
  if (!fs::is_directory(from)) return {from.string()};
  std::vector<std::string> files;
  for (std::size_t r = 1; r <= kReceivers; ++r) {
    const fs::path file = from / fmt::format("rx{}.dat", r);
    if (!fs::exists(file))
      refuse(from, fmt::format("lacks {}: a window needs all three receivers", file.filename().string()),
             ExitStatus::no_input);
    files.push_back(file.string());
  }
  return files;
}

class RecordedSet final : public DataSet {
 public:
  RecordedSet(const fs::path& from, const DataSetOptions& options)
      : from_(from), options_(options), files_(files_of(from)), truth_(open_truth(from, options.grid_hz)) {
    about_ = {"recording", truth_ != nullptr, {}};
  }
  const SetAbout& about() const override { return about_; }

  LeftOut read(const WindowSink& sink, const Warn& warn) const override {
    if (!truth_) warn(fmt::format("{} holds no truth: the windows have no labels", from_.string()));
    FrontEndConfig config;
    config.grid_hz = options_.grid_hz;
    config.hop = options_.hop;
    FrontEnd front_end(config);
    LeftOut left_out;
    std::size_t given = 0;
    for_each_window(
        *open_replay({.files = files_, .rate_hz = 0, .loop = false}), front_end, kUsualJitter,
        [&](const Window& window) {
          const People* people = truth_ ? truth_->at(window, front_end) : nullptr;
          if (!window.links.all()) {
            ++left_out.incomplete;
          } else if (truth_ && people == nullptr) {
            ++left_out.unlabelled;
          } else {
            sink(
                {window.x, 0, {}, people ? std::span<const Skeleton>(*people) : std::span<const Skeleton>()});
            ++given;
          }
        });
    if (given == 0)
      refuse(from_,
             fmt::format(
                 "makes no whole window ({} lack a receiver, {} the truth); `csipose inspect` tells more",
                 left_out.incomplete, left_out.unlabelled));
    return left_out;
  }

 private:
  fs::path from_;
  DataSetOptions options_;
  std::vector<std::string> files_;
  std::unique_ptr<const TruthOf> truth_;
  SetAbout about_;
};

}  // namespace

bool is_recording(const fs::path& from) {
  return fs::is_directory(from) ? fs::exists(from / "rx1.dat") : from.extension() == ".mcap";
}

std::unique_ptr<const DataSet> open_recorded_set(const fs::path& from, const DataSetOptions& options) {
  return std::make_unique<RecordedSet>(from, options);
}

}  // namespace csipose::train
