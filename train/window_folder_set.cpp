#include "train/window_folder_set.h"

#include <fmt/format.h>
#include <signal.h>

#include <algorithm>
#include <charconv>
#include <fstream>
#include <nlohmann/json.hpp>

#include "model/safetensors.h"
#include "proto/shape.h"
#include "train/label_rows.h"
#include "train/refuse.h"
#include "train/window_folder.h"

namespace csipose::train {
namespace {

namespace fs = std::filesystem;
using Json = nlohmann::json;

constexpr std::array<std::string_view, 5> kFiles = {"windows.npy", "clip.npy", "labels.npy", "room.npy",
                                                    "about.json"};

std::string to_json(const SetAbout& about, std::size_t windows, const std::vector<std::uint8_t>& used) {
  Json rooms = Json::object();
  for (const auto& [number, name] : about.rooms)
    if (std::ranges::find(used, number) != used.end()) rooms[fmt::format("{}", number)] = name;
  Json json = {{"kind", about.kind}, {"labelled", about.labelled}, {"windows", windows}, {"rooms", rooms}};
  if (!about.clips.empty()) json["clips"] = about.clips;
  return json.dump(2) + "\n";
}

class WindowFolderSet final : public DataSet {
 public:
  explicit WindowFolderSet(const fs::path& folder)
      : about_(read_about(folder)),
        windows_(open_window_folder(folder)),
        rooms_(read_rooms(folder, windows_->size())) {
    about_.samples = windows_->samples();
  }
  const SetAbout& about() const override { return about_; }
  LeftOut read(const WindowSink& sink, const Warn&) const override {
    std::vector<float> x(kChannels * kTokens);
    for (std::size_t i = 0; i < windows_->size(); ++i) {
      windows_->read(i, x);
      LabelledWindow window{x, static_cast<std::uint32_t>(windows_->clip(i)), {}, windows_->people(i)};
      if (!rooms_.empty()) window.room = rooms_[i];
      sink(window);
    }
    return {};
  }

 private:
  SetAbout about_;
  std::shared_ptr<const WindowSource> windows_;
  std::vector<std::uint8_t> rooms_;
};

bool is_ours(const std::string& name) { return std::ranges::find(kFiles, name) != kFiles.end(); }

/// Takes away what an interrupted run has left: files before windows.npy, and unfinished ones, NAME.part<process>.
void remove_leftovers(const fs::path& folder) {
  std::vector<fs::path> leftovers;
  for (const fs::directory_entry& entry : fs::directory_iterator(folder)) {
    const std::string name = entry.path().filename().string();
    const std::size_t part = name.find(".part");
    if (!is_ours(name.substr(0, part)))
      refuse(folder, fmt::format("holds {}, which is of something else; name another folder", name),
             ExitStatus::cannot_create);
    pid_t process = 0;
    if (part != std::string::npos)
      std::from_chars(name.data() + part + 5, name.data() + name.size(), process);
    if (process > 0 && ::kill(process, 0) == 0)
      refuse(folder, fmt::format("process {} is writing there; name another folder", process),
             ExitStatus::cannot_create);
    leftovers.push_back(entry.path());
  }
  for (const fs::path& file : leftovers) fs::remove(file);
}

fs::path prepared(fs::path folder) {
  std::error_code error;
  fs::create_directories(folder, error);
  if (error) refuse(folder, "cannot be made: " + error.message(), ExitStatus::cannot_create);
  if (fs::exists(folder / "windows.npy"))
    refuse(folder, "holds windows already; name another folder", ExitStatus::cannot_create);
  remove_leftovers(folder);
  return folder;
}

}  // namespace

std::unique_ptr<const DataSet> open_window_folder_set(const fs::path& folder) {
  return std::make_unique<WindowFolderSet>(folder);
}

WindowFolderWriter::WindowFolderWriter(fs::path folder, std::size_t samples)
    : folder_(prepared(std::move(folder))),
      samples_(samples),
      windows_(folder_ / "windows.npy", {kChannels, samples, kLinks}) {}

void WindowFolderWriter::add(const LabelledWindow& window) {
  for (std::size_t c = 0; c < kChannels; ++c)
    kept_.insert(kept_.end(), window.x.begin() + c * kSamples * kLinks,
                 window.x.begin() + (c * kSamples + samples_) * kLinks);
  windows_.append(kept_);
  kept_.clear();
  clips_.push_back(window.clip);
  people_.emplace_back(window.people.begin(), window.people.end());
  if (window.room) rooms_.push_back(*window.room);
}

void WindowFolderWriter::write_labels() const {
  std::size_t most = 1;
  for (const auto& people : people_) most = std::max(most, people.size());
  std::vector<float> rows;
  for (const auto& people : people_) append_row(people, most, rows);
  write_npy<float>(folder_ / "labels.npy", {people_.size(), most, kJoints, 3}, rows);
}

void WindowFolderWriter::finish(const SetAbout& about) {
  assert(rooms_.empty() || rooms_.size() == clips_.size());
  write_npy<std::uint32_t>(folder_ / "clip.npy", {clips_.size()}, clips_);
  if (about.labelled) write_labels();
  if (!rooms_.empty()) write_npy<std::uint8_t>(folder_ / "room.npy", {rooms_.size()}, rooms_);
  const std::string json = to_json(about, clips_.size(), rooms_);
  write_file_atomically(folder_ / "about.json",
                        {reinterpret_cast<const std::uint8_t*>(json.data()), json.size()});
  windows_.finish();
}

}  // namespace csipose::train
