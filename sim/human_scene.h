// sim/human_scene.h - people in a room: the labelled counterpart of object_clip.h.
#pragma once

#include "sim/moving_scene.h"
#include "sim/scene_file.h"

namespace csipose::sim {

/// Who does what where.
struct HumanSpec {
  RoomPlan room;
  std::size_t people = 1;
  std::vector<Action> allowed;  ///< at least one
  bool chairs = false;          ///< who begins by sitting gets a chair
};

/// Where people may be in a room; what they do is left open.
Stage stage_of(const RoomPlan& room);
/// The sixteen bodies and the labels of one person.
void add_person(const Motion& person, double t_s, const Surface& skin, MovingScene::Snapshot& out);

class HumanScene final : public MovingScene {
 public:
  /// The same for the same seed and clip.
  HumanScene(const HumanSpec& spec, std::uint64_t seed, std::uint32_t clip, double rate_hz);

  /// Furniture includes the chairs.
  const Scene& still() const override { return still_; }
  std::size_t people() const override { return crowd_.people().size(); }
  void next(Snapshot& out) override;

  const Crowd& crowd() const { return crowd_; }
  /// What person i did at the last instant that next() gave.
  Action action(std::size_t person) const { return crowd_.people()[person]->action_at(now_s_); }

 private:
  Scene still_;
  Crowd crowd_;
  Surface skin_;
  double rate_hz_, now_s_ = 0;
  std::uint64_t number_ = 0;
};

/// A room drawn for one clip: an area of 4 x 3.5 m and 0.2-1 m on each side of it, 2.5-3.2 m high, walls as in sim-object, up to
/// three pieces of furniture. Devices near the walls, or with `opposite` as in the published set: the transmitter at one side
/// of the area, receivers at the three others, 1.0-1.4 m high.
RoomPlan draw_room(std::uint64_t seed, std::uint32_t clip, bool opposite);

}  // namespace csipose::sim
