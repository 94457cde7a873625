// tests/sim/bvh_text.h - motion capture files made here: a person of 1.7 m in a T, joints named as by Mixamo.
#pragma once

#include <fmt/format.h>

#include <map>
#include <string>
#include <vector>

namespace csipose::sim {

/// Angles in degrees by channel ("LeftArm.Zrotation"), places in centimetres; what is not named is 0.
using BvhFrame = std::map<std::string, double>;

/// One joint: offset and, in brackets, children. Arms point along x, left is +x, ahead +z, up +y.
struct MadeJoint {
  std::string name;
  std::array<double, 3> offset;
  std::vector<MadeJoint> children;
};

inline MadeJoint made_arm(const std::string& side, double sign) {
  const MadeJoint tip{"", {sign * 4, 0, 0}, {}};
  const MadeJoint hand{side + "Hand",
                       {sign * 25, 0, 0},
                       {{side + "HandThumb1", {sign * 3, 0, 3}, {{"", {sign * 3, 0, 2}, {}}}},
                        {side + "HandMiddle1", {sign * 9, 0, 0}, {tip}}}};
  const MadeJoint fore{side + "ForeArm", {sign * 31, 0, 0}, {hand}};
  return {side + "Shoulder", {sign * 3, 24, 0}, {{side + "Arm", {sign * 13, 0, 0}, {fore}}}};
}
inline MadeJoint made_leg(const std::string& side, double sign) {
  const MadeJoint toe{side + "ToeBase", {0, -6, 13}, {{"", {0, 0, 6}, {}}}};
  const MadeJoint shank{side + "Leg", {0, -41, 0}, {{side + "Foot", {0, -42, 0}, {toe}}}};
  return {side + "UpLeg", {sign * 9, -4, 0}, {shank}};
}
inline MadeJoint made_person() {
  const MadeJoint neck{"Neck", {0, 29, 0}, {{"Head", {0, 10, 0}, {{"", {0, 18, 0}, {}}}}}};
  return {"Hips",
          {0, 95, 0},
          {{"Spine", {0, 20, 0}, {made_arm("Left", 1), neck, made_arm("Right", -1)}},
           made_leg("Left", 1),
           made_leg("Right", -1)}};
}

class BvhWriter {
 public:
  explicit BvhWriter(std::string rotations = "Zrotation Xrotation Yrotation", std::string prefix = "")
      : rotations_(std::move(rotations)), prefix_(std::move(prefix)) {}

  std::string operator()(const std::vector<BvhFrame>& frames, double frame_s = 0.01,
                         const MadeJoint& root = made_person()) {
    text_ = "HIERARCHY\n";
    channels_.clear();
    add(root, 0);
    text_ += fmt::format("MOTION\nFrames: {}\nFrame Time: {}\n", frames.size(), frame_s);
    for (const BvhFrame& frame : frames) {
      for (const std::string& channel : channels_)
        text_ += fmt::format("{} ", frame.contains(channel) ? frame.at(channel) : 0.0);
      text_ += "\n";
    }
    return text_;
  }

 private:
  void add(const MadeJoint& joint, int depth) {
    const std::string in(static_cast<std::size_t>(2 * depth), ' ');
    text_ += joint.name.empty()
                 ? in + "End Site\n"
                 : fmt::format("{}{} {}{}\n", in, depth ? "JOINT" : "ROOT", prefix_, joint.name);
    text_ +=
        fmt::format("{}{{\n{}  OFFSET {} {} {}\n", in, in, joint.offset[0], joint.offset[1], joint.offset[2]);
    if (!joint.name.empty()) {
      const std::string channels = (depth == 0 ? "Xposition Yposition Zposition " : "") + rotations_;
      text_ += fmt::format("{}  CHANNELS {} {}\n", in, depth == 0 ? 6 : 3, channels);
      for (std::size_t at = 0; at < channels.size();
           at = channels.find_first_not_of(' ', channels.find(' ', at)))
        channels_.push_back(joint.name + "." + channels.substr(at, channels.find(' ', at) - at));
    }
    for (const MadeJoint& child : joint.children) add(child, depth + 1);
    text_ += in + "}\n";
  }

  std::string rotations_, prefix_, text_;
  std::vector<std::string> channels_;
};

/// The text with one passage put in another's place; fails silently never: `from` must be there.
inline std::string replaced(std::string text, const std::string& from, const std::string& to) {
  const std::size_t at = text.find(from);
  if (at == std::string::npos) throw std::logic_error("not in the text: " + from);
  return text.replace(at, from.size(), to);
}

}  // namespace csipose::sim
