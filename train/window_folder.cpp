#include "train/window_folder.h"

#include <fmt/format.h>

#include <algorithm>
#include <charconv>
#include <cmath>
#include <cstring>
#include <fstream>
#include <nlohmann/json.hpp>

#include "proto/mapped_file.h"
#include "proto/npy.h"
#include "train/label_rows.h"
#include "train/refuse.h"

namespace csipose::train {
namespace {

namespace fs = std::filesystem;
using Json = nlohmann::json;

class WindowFolder : public WindowSource {
 public:
  explicit WindowFolder(const fs::path& folder) : folder_(folder), file_(folder / "windows.npy") {
    const Result<NpyView, std::string> view = parse_npy(file_.bytes());
    if (!view) refuse(folder / "windows.npy", view.error());
    if (view->descr != "<f4" || view->fortran_order || view->shape.size() != 4 ||
        view->shape[1] != kChannels || view->shape[2] < 1 || view->shape[2] > kSamples ||
        view->shape[3] != kLinks)
      refuse(folder / "windows.npy", "is no float32 array of shape (n, 60, 20 or less, 9) in C order");
    samples_ = view->shape[2];
    numbers_ = view->data;
    const NpyArray<std::uint32_t> clips = read_npy<std::uint32_t>(folder / "clip.npy");
    if (clips.shape != NpyShape{view->shape[0]})
      refuse(folder / "clip.npy",
             fmt::format("has not one number for each of the {} windows", view->shape[0]));
    clips_ = clips.data;
    people_.resize(clips_.size());
    rooms_ = read_rooms(folder, clips_.size());
    about_ = read_about(folder);
    if (fs::exists(folder / "labels.npy")) read_labels(folder / "labels.npy");
  }

  std::size_t size() const override { return clips_.size(); }
  std::string name() const override {
    return (folder_.has_filename() ? folder_ : folder_.parent_path()).filename().string();
  }
  std::size_t samples() const override { return samples_; }
  void read(std::size_t i, std::span<float> x) const override {
    const std::size_t kept = samples_ * kLinks, row = kSamples * kLinks;
    const auto held = [&](std::size_t t) {
      return t * samples_ / kSamples;
    };  // each for its part of the window
    for (std::size_t c = 0; c < kChannels; ++c) {
      const std::span<float> channel = x.subspan(c * row, row);
      std::memcpy(channel.data(), numbers_.data() + (i * kChannels + c) * kept * sizeof(float),
                  kept * sizeof(float));
      for (const float value : channel.first(kept))
        if (!std::isfinite(value))
          refuse(folder_ / "windows.npy", fmt::format("window {} holds a number that is not finite", i));
      for (std::size_t t = kSamples; t-- > 0;)  // from the end: what is still to be copied lies before it
        std::copy_n(channel.begin() + held(t) * kLinks, kLinks, channel.begin() + t * kLinks);
    }
  }
  std::span<const Skeleton> people(std::size_t i) const override { return people_[i]; }
  std::uint64_t clip(std::size_t i) const override { return clips_[i]; }
  std::string clip_name(std::size_t i) const override {
    return about_.clips.empty() ? std::string() : fmt::format("{} {}", about_.clips, clips_[i]);
  }
  std::string room(std::size_t i) const override {
    if (rooms_.empty()) return name();
    const auto named = about_.rooms.find(rooms_[i]);
    return named != about_.rooms.end() ? named->second : fmt::format("{} {}", name(), rooms_[i]);
  }

 private:
  void read_labels(const fs::path& path) {
    const NpyArray<float> labels = read_npy<float>(path);
    if (labels.shape.size() != 4 || labels.shape[0] != size() || labels.shape[2] != kJoints ||
        labels.shape[3] != 3)
      refuse(path, fmt::format("is no array of shape ({}, people, 14, 3)", size()));
    const std::size_t width = labels.shape[1] * kPoseWidth;
    for (std::size_t i = 0; i < size(); ++i) {
      auto people = people_of_row(std::span(labels.data).subspan(i * width, width));
      if (!people) refuse(path, fmt::format("window {} has a person of whom some joints are no numbers", i));
      people_[i] = std::move(*people);
    }
  }

  fs::path folder_;
  MappedFile file_;
  ByteView numbers_;
  std::size_t samples_ = kSamples;
  std::vector<std::uint32_t> clips_;
  std::vector<std::vector<Skeleton>> people_;
  std::vector<std::uint8_t> rooms_;
  SetAbout about_;
};

}  // namespace

std::shared_ptr<const WindowSource> open_window_folder(const fs::path& folder) {
  return std::make_shared<WindowFolder>(folder);
}

std::vector<std::uint8_t> read_rooms(const fs::path& folder, std::size_t windows) {
  const fs::path path = folder / "room.npy";
  if (!fs::exists(path)) return {};
  NpyArray<std::uint8_t> rooms = read_npy<std::uint8_t>(path);
  if (rooms.shape != NpyShape{windows}) refuse(path, "has not one number for each window");
  return std::move(rooms.data);
}

SetAbout read_about(const fs::path& folder) {
  SetAbout about{"windows", fs::exists(folder / "labels.npy"), {}};
  const fs::path path = folder / "about.json";
  std::ifstream file(path);
  if (!file) return about;
  try {
    const Json json = Json::parse(file);
    about.kind = json.at("kind").get<std::string>();
    about.clips = json.value("clips", std::string());
    for (const auto& [number, name] : json.at("rooms").items()) {
      std::uint8_t room = 0;
      const char* end = number.data() + number.size();
      if (std::from_chars(number.data(), end, room).ptr != end) refuse(path, "a room has no number");
      about.rooms[room] = name.get<std::string>();
      if (about.rooms[room].find('/') != std::string::npos) refuse(path, "a room's name holds a slash");
    }
  } catch (const Json::exception& error) {
    refuse(path, fmt::format("is not what a data set says of itself: {}", error.what()));
  }
  return about;
}

}  // namespace csipose::train
