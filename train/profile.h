// train/profile.h - what a data set looks like: windows by scene, amplitudes of links, bones, and which way its axes go.
#pragma once

#include <array>
#include <cstdint>
#include <map>
#include <string>

#include "train/data_set.h"

namespace csipose::train {

/// The windows of a scene or room.
struct ProfileGroup {
  std::size_t windows = 0;
  std::map<std::size_t, std::size_t> by_people;  ///< windows by number of people
  std::array<double, kLinks> amplitude_sum{};    ///< of each window's mean
  double mean_amplitude(std::size_t link) const { return amplitude_sum[link] / static_cast<double>(windows); }
};

/// Which way the axes of labels go, told by people's bodies: necks are above ankles, knees bend forward.
struct LabelAxes {
  double up = 0;           ///< +1: axis 2 points up, -1: down
  std::size_t people = 0;  ///< that were looked at
  double left = 0;         ///< share of people whose left . (up x forward) is positive, with axis 2 turned up
  std::size_t bent = 0;    ///< people whose knees stand out by 5 cm or more, level
  double left_of_bent = 0;  ///< the same share of these
};

class Profile {
 public:
  explicit Profile(SetAbout about) : about_(std::move(about)) {}
  void add(const LabelledWindow& window);

  /// By "scene 2" for the published set, by the room's name for others, "all" where none is known.
  const std::map<std::string, ProfileGroup>& groups() const { return groups_; }
  std::size_t people() const { return people_; }
  /// Mean distance of two joints, metres; NaN without people.
  double mean_length_m(std::size_t joint, std::size_t other) const;
  LabelAxes axes() const;
  /// Everything as text.
  std::string describe() const;

 private:
  std::string group_of(const LabelledWindow& window) const;
  void add_person(const Skeleton& person);
  std::string describe_groups() const;
  std::string describe_bones() const;
  std::string describe_axes() const;

  SetAbout about_;
  std::map<std::string, ProfileGroup> groups_;
  std::size_t people_ = 0;
  std::array<std::array<double, kJoints>, kJoints> length_sum_m_{};
  double neck_over_ankles_m_ = 0;  // along axis 2, summed
  std::size_t left_ = 0, bent_ = 0, left_of_bent_ = 0;
};

}  // namespace csipose::train
