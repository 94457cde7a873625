// sim/captured_motion.h - a person who moves as one was seen to move: a motion capture file as a Motion.
//
// Joints are taken from the file with its own lengths of bones; between two frames joints turn along the shortest way (slerp)
// and the body moves straight. What the file does not hold is added: girth and breath, drawn as for everybody.
#pragma once

#include <optional>

#include "sim/bvh_naming.h"
#include "sim/motion.h"
#include "sim/people.h"

namespace csipose::sim {

class CapturedMotion final : public Motion {
 public:
  struct Part {
    double from_s = 0;                      ///< of the file; 0 here
    double seconds = 1e9;                   ///< or as much as there is
    std::optional<double> metres_per_unit;  ///< instead of the naming's
    std::optional<bool> z_up;               ///< likewise; and then it is true, even of one who never stands
  };

  /// Throws SetupError (bad_data) for a skeleton that cannot be a person's: too small or large (wrong unit), bones without
  /// length, feet that point backward (left and right exchanged); for one who never stands, unless part.z_up is given.
  CapturedMotion(const BvhClip& clip, const Landmarks& landmarks, const Part& part, CounterRng rng);

  const Figure& figure() const override { return figure_; }
  /// The first or last frame outside the file's time.
  ///   cost  some 20 joints, no allocation
  Stance at(double t_s) const override;
  double seconds() const { return frame_s_ * static_cast<double>(frames_ - 1); }

  /// Turns the whole way to the left and moves it, so that the middle of the rectangle about it lies at `middle`; the lowest
  /// that a foot comes is the floor. At first the way is not turned and its middle is the origin.
  void put(const Vec3& middle, double turn_rad);
  /// About the way of the hips.
  Rectangle way() const;

 private:
  static constexpr std::size_t kNone = ~std::size_t{0};
  /// A joint that decides about a landmark; its parent comes before it.
  struct Node {
    std::size_t parent;
    Vec3 offset_m;
    std::size_t mover;   ///< into the places of a frame, of joints that carry the whole body; else kNone
    std::size_t turner;  ///< into its turns; kNone of an end site
  };
  struct Pose;

  void add_nodes(const BvhClip& clip, const Landmarks& landmarks, double metres_per_unit);
  void read_frames(const BvhClip& clip, const Part& part, double metres_per_unit);
  void measure(const BvhClip& clip, const Landmarks& landmarks, double metres_per_unit);
  void expect_upright(const BvhClip& clip) const;
  void find_soles(const BvhClip& clip);
  void stand_on_floor();
  void pose_at(double t_s, Pose& pose) const;
  Stance stance_of(const Pose& pose) const;
  Vec3 aim(const Pose& pose, std::size_t from, std::size_t at, const Vec3& otherwise) const;
  double time_of(std::size_t frame) const { return frame_s_ * static_cast<double>(frame); }

  Figure figure_{1.7};
  Sine breath_;
  double frame_s_;
  std::size_t frames_ = 0;
  std::vector<Node> nodes_;
  std::vector<std::size_t> source_;              ///< which joint of the file a node is
  std::array<std::size_t, kLandmarks> marks_{};  ///< into nodes_
  std::size_t crown_ = kNone;                    ///< what head, hands and feet point to; may be missing
  std::array<std::size_t, 2> fingers_{}, toes_{};
  std::array<Vec3, 2> soles_{};    ///< direction of the toes when the foot is flat, in the ankle's axes
  std::vector<Vec3> places_;       ///< [frame][mover]
  std::vector<glm::dquat> turns_;  ///< [frame][turner]
  std::size_t movers_ = 0, turners_ = 0;
  glm::dquat room_from_file_{1, 0, 0, 0};
  glm::dquat upright_{1, 0, 0, 0};  ///< the file's axes to x ahead, z up
  Vec3 shift_m_{};
  double floor_m_ = 0;
};

}  // namespace csipose::sim
