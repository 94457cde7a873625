#include "train/published_set.h"

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <algorithm>
#include <optional>

#include "proto/mapped_file.h"
#include "train/mat_file.h"
#include "train/published_files.h"
#include "train/refuse.h"
#include "train/snapshot_windows.h"

namespace csipose::train {
namespace {

namespace fs = std::filesystem;

constexpr std::string_view kSuffix = "_data";

std::string_view text_of(const MappedFile& file) {
  return {reinterpret_cast<const char*>(file.bytes().data()), file.bytes().size()};
}

fs::path folder_of(const fs::path& root, const std::string& split) {
  return root / (split + std::string(kSuffix));
}
fs::path list_of(const fs::path& root, const std::string& split) {
  return folder_of(root, split) / fmt::format("{}{}_list.txt", split, kSuffix);
}

EnvironmentMap read_environments(const fs::path& path) {
  if (path.empty()) return {};
  const MappedFile file(path);
  const Result<EnvironmentMap, std::string> map = EnvironmentMap::parse(text_of(file));
  if (!map) refuse(path, map.error(), ExitStatus::bad_config);
  return *map;
}

/// The splits that were asked for, each with a list.
std::vector<std::string> wanted_splits(const fs::path& root, std::string split) {
  const std::vector<std::string> there = splits_of_published_set(root);
  if (split.empty()) return there;
  if (split.ends_with(kSuffix)) split.resize(split.size() - kSuffix.size());
  if (std::ranges::find(there, split) == there.end())
    refuse(root,
           fmt::format("has no split \"{}\": {} is missing; there is {}", split,
                       list_of(root, split).string(), fmt::join(there, ", ")),
           ExitStatus::no_input);
  return {split};
}

NameList read_list(const fs::path& path) {
  const MappedFile file(path);
  Result<NameList, std::string> list = parse_name_list(text_of(file));
  if (!list) refuse(path, list.error());
  return std::move(*list);
}

std::vector<Skeleton> read_keypoints(const fs::path& path) {
  const MappedFile file(path);
  Result<std::vector<Skeleton>, std::string> people = parse_keypoints(file.bytes());
  if (!people) refuse(path, people.error());
  return std::move(*people);
}

class PublishedSet final : public DataSet {
 public:
  PublishedSet(const fs::path& root, const DataSetOptions& options)
      : root_(root),
        options_(options),
        splits_(wanted_splits(root, options.split)),
        environments_(read_environments(options.env_map)) {
    about_ = {"published", true, environments_.names()};
    about_.clips = fmt::format("published {}", fs::weakly_canonical(root).filename().string());
    for (const std::string& split : splits_)
      for (const char* part : {"csi", "keypoint"})
        if (!fs::is_directory(folder_of(root, split) / part))
          refuse(folder_of(root, split), fmt::format("lacks the folder {}", part), ExitStatus::no_input);
  }
  const SetAbout& about() const override { return about_; }

  LeftOut read(const WindowSink& sink, const Warn& warn) const override {
    if (options_.split.empty())
      for (const char* usual : {"train", "test"})
        if (std::ranges::find(splits_, usual) == splits_.end())
          warn(fmt::format("{} is missing: the set is taken without it", list_of(root_, usual).string()));
    LeftOut left_out;
    std::size_t given = 0;
    for (const Entry& entry : entries(warn)) {
      try {
        give(entry, sink, warn);
        ++given;
      } catch (const Broken& broken) {
        if (!options_.skip_broken) throw SetupError(broken.error.status, broken.error.what());
        warn(fmt::format("left out: {}", broken.error.what()));
        ++left_out.broken;
      }
    }
    if (given == 0) refuse(root_, "no window can be used");
    return left_out;
  }

 private:
  struct Entry {
    WindowName name;
    const std::string* split;
  };
  /// A window's files cannot be used. What a sink throws is another thing.
  struct Broken {
    SetupError error;
  };

  /// All names of the lists, clip by clip.
  std::vector<Entry> entries(const Warn& warn) const {
    std::vector<Entry> all;
    for (const std::string& split : splits_) {
      const fs::path path = list_of(root_, split);
      NameList list = read_list(path);
      if (list.names.empty()) refuse(path, "names no window before its first empty line");
      if (list.after_end > 0)
        warn(fmt::format("{}: the empty line ends the list; {} lines after it are not read", path.string(),
                         list.after_end));
      for (WindowName& name : list.names) all.push_back({std::move(name), &split});
    }
    std::ranges::stable_sort(
        all, {}, [](const Entry& entry) { return std::pair(entry.name.clip_number(), entry.name.frame); });
    const auto same = [](const Entry& a, const Entry& b) { return a.name.text == b.name.text; };
    const auto twice = std::unique(all.begin(), all.end(), same);
    if (twice != all.end())
      warn(fmt::format("{}: {} names are listed more than once; each is taken once", root_.string(),
                       all.end() - twice));
    all.erase(twice, all.end());
    return all;
  }

  void give(const Entry& entry, const WindowSink& sink, const Warn& warn) const {
    const fs::path folder = folder_of(root_, *entry.split);
    SnapshotWindows stream(options_.grid_hz);
    std::vector<Skeleton> people;
    try {
      const std::vector<StreamCsi> csi = read_mat(folder / "csi" / (entry.name.text + ".mat"));
      for (std::size_t t = 0; t < kSamples; ++t)
        for (std::uint8_t r = 0; r < kReceivers; ++r) stream.put(t, r, csi[t * kReceivers + r]);
      people = read_keypoints(folder / "keypoint" / (entry.name.text + ".npy"));
    } catch (const SetupError& error) {
      throw Broken{error};
    }
    if (people.size() != entry.name.people)
      warn(fmt::format("{}: {} people are labelled, the name says {}; the labels are taken", entry.name.text,
                       people.size(), entry.name.people));
    sink({stream.next().x, entry.name.clip_number(), environment(entry.name), people});
  }

  std::uint8_t environment(const WindowName& name) const {
    const std::optional<std::uint8_t> number = environments_.of_scene(name.scene);
    if (!number)
      refuse(options_.env_map, fmt::format("scene {} of {} is in no environment", name.scene, name.text),
             ExitStatus::bad_config);
    return *number;
  }

  fs::path root_;
  DataSetOptions options_;
  std::vector<std::string> splits_;
  EnvironmentMap environments_;
  SetAbout about_;
};

}  // namespace

bool is_published_set(const fs::path& root) { return !splits_of_published_set(root).empty(); }

std::unique_ptr<const DataSet> open_published_set(const fs::path& root, const DataSetOptions& options) {
  return std::make_unique<PublishedSet>(root, options);
}

std::vector<std::string> splits_of_published_set(const fs::path& root) {
  std::vector<std::string> splits;
  if (!fs::is_directory(root)) return splits;
  for (const fs::directory_entry& entry : fs::directory_iterator(root)) {
    std::string name = entry.path().filename().string();
    if (!name.ends_with(kSuffix)) continue;
    name.resize(name.size() - kSuffix.size());
    if (fs::exists(list_of(root, name))) splits.push_back(name);
  }
  std::ranges::sort(splits);
  return splits;
}

}  // namespace csipose::train
