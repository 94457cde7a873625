#include "sim/bvh.h"

#include <fmt/core.h>

#include <algorithm>
#include <cctype>
#include <charconv>
#include <cmath>
#include <glm/gtc/constants.hpp>

#include "proto/result.h"
#include "sim/json_file.h"

namespace csipose::sim {
namespace {
constexpr std::array<std::string_view, BvhClip::kChannelKinds> kChannelNames{
    "Xposition", "Yposition", "Zposition", "Xrotation", "Yrotation", "Zrotation"};
constexpr double kLeastFrame_s = 1e-4, kMostFrame_s = 10;

bool is_space(char c) { return std::isspace(static_cast<unsigned char>(c)) != 0; }

bool same_word(std::string_view a, std::string_view b) {
  const auto lower = [](char c) { return std::tolower(static_cast<unsigned char>(c)); };
  return std::equal(a.begin(), a.end(), b.begin(), b.end(),
                    [&](char x, char y) { return lower(x) == lower(y); });
}

/// The text word by word or line by line; knows the line for messages.
class Words {
 public:
  Words(std::string_view text, const std::string& file_name) : rest_(text), file_name_(file_name) {}

  [[noreturn]] void refuse(const std::string& why) const {
    throw SetupError(ExitStatus::bad_data, fmt::format("{}:{}: {}", file_name_, line_, why));
  }
  /// The next word; braces are words of their own. Empty at the end.
  std::string_view word() {
    skip_space();
    const bool brace = !rest_.empty() && is_brace(rest_[0]);
    std::size_t n = brace ? 1 : 0;
    while (!brace && n < rest_.size() && !is_space(rest_[n]) && !is_brace(rest_[n])) ++n;
    return take(n);
  }
  /// What is left of this line up to a brace: a name, which may contain spaces, or nothing.
  std::string_view name() {
    std::size_t n = 0;
    while (n < rest_.size() && rest_[n] != '\n' && !is_brace(rest_[n])) ++n;
    return trimmed(take(n));
  }
  /// The next line that is not blank; empty at the end.
  std::string_view line() {
    skip_space();
    return trimmed(take(std::min(rest_.find('\n'), rest_.size())));
  }
  void expect(std::string_view wanted) {
    const std::string_view found = word();
    if (!same_word(found, wanted)) refuse(fmt::format("'{}' is due here{}", wanted, instead(found)));
  }
  double number(std::string_view found, double most = kMostBvhNumber) const {
    double value = 0;
    if (!found.empty() && found[0] == '+') found.remove_prefix(1);
    const auto end = std::from_chars(found.data(), found.data() + found.size(), value);
    if (end.ec != std::errc() || end.ptr != found.data() + found.size() || !std::isfinite(value))
      refuse(fmt::format("a number is due here{}; it is written with a point and without units",
                         instead(found)));
    if (std::abs(value) > most) refuse(fmt::format("{} is too large; {} is the most", value, most));
    return value;
  }
  std::size_t count(std::string_view found) const {
    std::size_t value = 0;
    const auto end = std::from_chars(found.data(), found.data() + found.size(), value);
    if (end.ec != std::errc() || end.ptr != found.data() + found.size())
      refuse(fmt::format("a whole number is due here{}", instead(found)));
    return value;
  }
  static std::string instead(std::string_view found) {
    constexpr std::size_t kShown = 40;
    return found.empty() ? ", but the file ends; is it cut off?"
                         : fmt::format(", not '{}'", printable(found.substr(0, kShown)));
  }
  static std::string printable(std::string_view text) {
    std::string shown(text);
    std::replace_if(
        shown.begin(), shown.end(), [](char c) { return c < ' ' || c > '~'; }, '?');
    return shown;
  }
  std::size_t line_number() const { return line_; }

 private:
  static bool is_brace(char c) { return c == '{' || c == '}'; }
  static std::string_view trimmed(std::string_view text) {
    while (!text.empty() && is_space(text.front())) text.remove_prefix(1);
    while (!text.empty() && is_space(text.back())) text.remove_suffix(1);
    return text;
  }
  void skip_space() {
    while (!rest_.empty() && is_space(rest_[0])) {
      if (rest_[0] == '\n') ++line_;
      rest_.remove_prefix(1);
    }
  }
  std::string_view take(std::size_t n) {
    const std::string_view taken = rest_.substr(0, n);
    rest_.remove_prefix(n);
    return taken;
  }

  std::string_view rest_;
  const std::string& file_name_;
  std::size_t line_ = 1;
};

/// HIERARCHY: joints in the order of the file.
class Tree {
 public:
  Tree(Words& words, BvhClip& clip) : words_(words), clip_(clip) {}

  void read() {
    words_.expect("HIERARCHY");
    words_.expect("ROOT");
    open_joint(false);
    while (!open_.empty()) read_item();
    if (clip_.channels == 0) words_.refuse("no joint has channels: there is no motion to read");
  }

 private:
  struct Open {
    int joint;
    bool is_end, has_offset;
  };

  void open_joint(bool is_end) {
    if (clip_.joints.size() == kMostBvhJoints)
      words_.refuse(fmt::format("more than {} joints; a person has some 20 to 80", kMostBvhJoints));
    BvhClip::Joint joint;
    joint.name = words_.name();  // that of an end site is of no use
    if (is_end)
      joint.name.clear();
    else if (joint.name.empty())
      words_.refuse("the joint has no name; write it on the same line");
    joint.parent = open_.empty() ? -1 : open_.back().joint;
    joint.line = words_.line_number();
    words_.expect("{");
    open_.push_back({static_cast<int>(clip_.joints.size()), is_end, false});
    clip_.joints.push_back(std::move(joint));
  }

  void read_item() {
    const std::string_view word = words_.word();
    if (same_word(word, "OFFSET")) return read_offset();
    if (word == "}") return close_joint();
    if (!open_.back().is_end) {
      if (same_word(word, "CHANNELS")) return read_channels();
      if (same_word(word, "JOINT")) return open_joint(false);
      if (same_word(word, "End")) {
        words_.expect("Site");
        return open_joint(true);
      }
    }
    words_.refuse(fmt::format("{} is due here{}",
                              open_.back().is_end ? "OFFSET or }" : "OFFSET, CHANNELS, JOINT, End Site or }",
                              Words::instead(word)));
  }

  BvhClip::Joint& joint() { return clip_.joints[static_cast<std::size_t>(open_.back().joint)]; }

  void read_offset() {
    if (open_.back().has_offset) words_.refuse("a second OFFSET of the same joint");
    open_.back().has_offset = true;
    for (int axis = 0; axis < 3; ++axis) joint().offset[axis] = words_.number(words_.word());
  }

  void read_channels() {
    if (!joint().channels.empty()) words_.refuse("a second CHANNELS of the same joint");
    const std::size_t count = words_.count(words_.word());
    if (count > BvhClip::kChannelKinds)
      words_.refuse(fmt::format("{} channels; a joint has at most {}", count, BvhClip::kChannelKinds));
    joint().first_value = clip_.channels;
    for (std::size_t i = 0; i < count; ++i) joint().channels.push_back(channel());
    clip_.channels += count;
  }

  BvhClip::Channel channel() {
    const std::string_view word = words_.word();
    const auto found = std::find_if(kChannelNames.begin(), kChannelNames.end(),
                                    [&](std::string_view name) { return same_word(name, word); });
    if (found == kChannelNames.end())
      words_.refuse(
          fmt::format("a channel is due here{}; there are Xposition, Yposition, Zposition, Xrotation, "
                      "Yrotation, Zrotation, as many as CHANNELS says",
                      Words::instead(word)));
    const auto channel = static_cast<BvhClip::Channel>(found - kChannelNames.begin());
    const auto& channels = joint().channels;
    if (std::find(channels.begin(), channels.end(), channel) != channels.end())
      words_.refuse(fmt::format("'{}' twice in one joint", *found));
    return channel;
  }

  void close_joint() {
    if (!open_.back().has_offset) words_.refuse("the joint that ends here has no OFFSET");
    open_.pop_back();
  }

  Words& words_;
  BvhClip& clip_;
  std::vector<Open> open_;
};

/// "Frames: 12" -> "12"
std::string_view value_of(Words& words, std::string_view key) {
  std::string_view line = words.line();
  if (line.size() < key.size() || !same_word(line.substr(0, key.size()), key))
    words.refuse(fmt::format("'{}' is due here{}", key, Words::instead(line)));
  line.remove_prefix(key.size());
  while (!line.empty() && is_space(line[0])) line.remove_prefix(1);
  return line;
}

void read_frame(Words& words, std::string_view line, std::size_t frame, BvhClip& clip) {
  Words numbers(line, clip.file_name);
  std::size_t count = 0;
  for (std::string_view word = numbers.word(); !word.empty(); word = numbers.word(), ++count)
    if (count < clip.channels) clip.values.push_back(words.number(word));
  if (count != clip.channels)
    words.refuse(
        fmt::format("frame {} has {} numbers; the joints have {} channels", frame + 1, count, clip.channels));
}

void read_motion(Words& words, BvhClip& clip) {
  words.expect("MOTION");
  const std::size_t frames = words.count(value_of(words, "Frames:"));
  if (frames == 0) words.refuse("no frames: there is no motion to read");
  clip.frame_s = words.number(value_of(words, "Frame Time:"));
  if (clip.frame_s < kLeastFrame_s || clip.frame_s > kMostFrame_s)
    words.refuse(fmt::format("a frame time of {} s; it must lie in {} .. {}", clip.frame_s, kLeastFrame_s,
                             kMostFrame_s));
  for (std::size_t frame = 0; frame < frames; ++frame) {
    const std::string_view line = words.line();
    if (line.empty())
      words.refuse(fmt::format("the file ends after {} of {} frames; is it cut off?", frame, frames));
    read_frame(words, line, frame, clip);
  }
  if (!words.line().empty()) words.refuse(fmt::format("more follows after the last of {} frames", frames));
}

}  // namespace

Vec3 BvhClip::position(std::size_t frame, std::size_t joint) const {
  const Joint& it = joints[joint];
  Vec3 place = it.offset;
  for (std::size_t i = 0; i < it.channels.size(); ++i)
    if (it.channels[i] < kFirstRotation)
      place[it.channels[i]] = values[frame * channels + it.first_value + i];
  return place;
}

glm::dquat BvhClip::rotation(std::size_t frame, std::size_t joint) const {
  const Joint& it = joints[joint];
  glm::dquat turn(1, 0, 0, 0);
  for (std::size_t i = 0; i < it.channels.size(); ++i) {
    if (it.channels[i] < kFirstRotation) continue;
    Vec3 axis{0};
    axis[it.channels[i] - kFirstRotation] = 1;
    turn = turn * glm::angleAxis(glm::radians(values[frame * channels + it.first_value + i]), axis);
  }
  return turn;
}

BvhClip parse_bvh(std::string_view text, const std::string& file_name) {
  BvhClip clip;
  clip.file_name = file_name;
  Words words(text, clip.file_name);
  Tree(words, clip).read();
  read_motion(words, clip);
  return clip;
}

BvhClip read_bvh(const std::filesystem::path& file) {
  return parse_bvh(read_text_file(file, "motion"), file.string());
}

}  // namespace csipose::sim
