// sim/captured_scene.h - people in a room who move as motion capture files say.
#pragma once

#include "sim/captured_motion.h"
#include "sim/moving_scene.h"
#include "sim/scene_file.h"

namespace csipose::sim {

/// Which files, and how to read them.
struct CaptureSpec {
  std::vector<std::filesystem::path> files;  ///< one person each
  std::filesystem::path namings;             ///< table of joints; empty = those that come with the program
  CapturedMotion::Part part;
};

/// Reads the files. The girth of person i and how it breathes depend on the seed.
std::vector<std::unique_ptr<CapturedMotion>> read_captured(const CaptureSpec& spec, std::uint64_t seed);

/// Puts everybody where their way stays in the room's area, off furniture and away from the others, turned as little as can be;
/// one alone as near to the middle as can be. Throws SetupError (bad_data) when there is no such place.
void put_into(const RoomPlan& room, std::span<const std::unique_ptr<CapturedMotion>> people,
              std::span<const std::filesystem::path> files);

class CapturedScene final : public MovingScene {
 public:
  CapturedScene(const RoomPlan& room, const CaptureSpec& spec, std::uint64_t seed, double rate_hz);

  const Scene& still() const override { return still_; }
  std::size_t people() const override { return people_.size(); }
  void next(Snapshot& out) override;

 private:
  Scene still_;
  std::vector<std::unique_ptr<CapturedMotion>> people_;
  Surface skin_;
  double rate_hz_;
  std::uint64_t number_ = 0;
};

}  // namespace csipose::sim
