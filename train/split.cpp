#include "train/split.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <set>

#include "model/seeded_random.h"
#include "train/refuse.h"
#include "train/window_folder.h"
#include "train/window_folder_set.h"

namespace csipose::train {
namespace {

namespace fs = std::filesystem;

/// Folders that are filled at the same time.
class Parts {
 public:
  explicit Parts(fs::path to) : to_(std::move(to)) {}
  WindowFolderWriter& of(const std::string& name, const SetAbout& about) {
    auto& writer = writers_[name];
    if (!writer) writer = std::make_unique<WindowFolderWriter>(to_ / name, about.samples);
    return *writer;
  }
  std::vector<SplitPart> finish(const SetAbout& about) {
    std::vector<SplitPart> parts;
    for (auto& [name, writer] : writers_) {
      writer->finish(about);
      parts.push_back({name, writer->windows()});
    }
    return parts;
  }

 private:
  fs::path to_;
  std::map<std::string, std::unique_ptr<WindowFolderWriter>> writers_;
};

/// So many of `count` that `share` of them are drawn, at least one.
std::size_t drawn_of(std::size_t count, double share) {
  const double wanted = std::round(share * static_cast<double>(count));
  return std::clamp<std::size_t>(static_cast<std::size_t>(wanted), std::min<std::size_t>(count, 1), count);
}

/// The first of `items` after they were shuffled.
template <class T>
std::set<T> draw(std::vector<T> items, double share, SeededRandom random) {
  const std::size_t count = drawn_of(items.size(), share);
  for (std::size_t i = 0; i < count; ++i) std::swap(items[i], items[i + random.index(items.size() - i)]);
  return {items.begin(), items.begin() + static_cast<std::ptrdiff_t>(count)};
}

/// Where windows are in a set: clips by room, windows by clip.
struct Places {
  std::map<std::uint8_t, std::set<std::uint32_t>> clips_of_room;
  std::map<std::uint32_t, std::vector<std::size_t>> windows_of_clip;
};
Places places_of(const fs::path& folder) {
  const auto windows = open_window_folder(folder);
  std::vector<std::uint8_t> rooms = read_rooms(folder, windows->size());
  rooms.resize(windows->size());
  Places places;
  for (std::size_t i = 0; i < windows->size(); ++i) {
    const auto clip = static_cast<std::uint32_t>(windows->clip(i));
    places.clips_of_room[rooms[i]].insert(clip);
    places.windows_of_clip[clip].push_back(i);
  }
  return places;
}

/// The windows that are drawn, by their place in the set.
std::set<std::size_t> drawn_windows(const Places& places, const SplitJob& job) {
  std::set<std::size_t> drawn;
  if (job.by == SplitBy::window) {
    for (const auto& [clip, windows] : places.windows_of_clip)
      drawn.merge(draw(windows, job.share, SeededRandom(job.seed, "few windows", {clip})));
    return drawn;
  }
  if (job.by == SplitBy::time) {
    for (const auto& [clip, windows] : places.windows_of_clip)
      drawn.insert(windows.end() - static_cast<std::ptrdiff_t>(drawn_of(windows.size(), job.share)),
                   windows.end());
    return drawn;
  }
  for (const auto& [room, clips] : places.clips_of_room)
    for (const std::uint32_t clip : draw(std::vector(clips.begin(), clips.end()), job.share,
                                         SeededRandom(job.seed, "few clips", {room}))) {
      const auto& windows = places.windows_of_clip.at(clip);
      drawn.insert(windows.begin(), windows.end());
    }
  return drawn;
}

std::vector<SplitPart> split_by_lists(const SplitJob& job, const Warn& warn) {
  const std::vector<std::string> names = splits_of(job.from);
  if (names.empty())
    refuse(job.from, "has no splits of its own; take --by environment, clip, window or time",
           ExitStatus::usage);
  Parts parts(job.to);
  SetAbout about;
  for (const std::string& name : names) {
    DataSetOptions options = job.options;
    options.split = name;
    const auto set = open_data_set(job.from, options);
    about = set->about();
    WindowFolderWriter& writer = parts.of(name, about);
    set->read([&](const LabelledWindow& window) { writer.add(window); }, warn);
  }
  return parts.finish(about);
}

}  // namespace

std::vector<SplitPart> split(const SplitJob& job, const Warn& warn) {
  if (job.by == SplitBy::lists) return split_by_lists(job, warn);
  if (!fs::exists(job.from / "windows.npy"))
    refuse(job.from, "is no folder of windows; make one with `csipose-train dataset convert`",
           ExitStatus::no_input);
  const auto set = open_window_folder_set(job.from);
  std::set<std::size_t> drawn;
  if (job.by != SplitBy::environment) drawn = drawn_windows(places_of(job.from), job);
  Parts parts(job.to);
  std::size_t i = 0;
  set->read(
      [&](const LabelledWindow& window) {
        if (job.by != SplitBy::environment)
          parts.of(drawn.count(i++) > 0 ? "drawn" : "rest", set->about()).add(window);
        else if (window.room)
          parts.of(set->about().room_name(*window.room), set->about()).add(window);
        else
          refuse(job.from, "has no room.npy: its environments are not known");
      },
      warn);
  return parts.finish(set->about());
}

}  // namespace csipose::train
