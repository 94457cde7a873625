// sim/picture.h - one instant of a moving scene as a picture: the room with who is in it, devices, the strongest paths, labels,
// and beside it what the receivers saw until then.
#pragma once

#include <deque>
#include <memory>
#include <opencv2/core/mat.hpp>
#include <string>

#include "sim/fast_solver.h"
#include "sim/moving_scene.h"
#include "sim/room_view.h"

namespace csipose::sim {

/// A moving scene that is played: bodies, labels and channel at one snapshot, and the channel's recent past.
class ScenePlayer {
 public:
  /// `step_s`: between the scene's instants; `past_s`: how much of the channel is kept.
  ScenePlayer(std::unique_ptr<MovingScene> scene, double step_s, double past_s);

  const Scene& still() const { return scene_->still(); }
  std::size_t people_count() const { return scene_->people(); }
  /// Plays on to snapshot number `snapshot`, counted from 0; never back.
  void run_to(std::size_t snapshot);
  double step_s() const { return step_s_; }
  double time_s() const { return static_cast<double>(now_) * step_s_; }
  double past_s() const { return past_s_; }
  const std::vector<Body>& bodies() const { return batch_[now_ % kSamples].bodies; }
  const std::vector<Joints>& people() const { return batch_[now_ % kSamples].people; }
  /// H[tone][receiver][antenna] of the snapshots up to now, the newest last.
  const std::deque<std::vector<std::complex<float>>>& channel() const { return channel_; }

 private:
  void solve_next_batch();

  std::unique_ptr<MovingScene> scene_;
  FastSolver solver_;
  double step_s_, past_s_;
  std::size_t now_ = 0, solved_ = 0;
  std::array<MovingScene::Snapshot, kSamples> batch_;
  std::vector<std::complex<float>> h_;
  std::deque<std::vector<std::complex<float>>> channel_;
};

struct PictureOptions {
  std::string title;
  int width = 1600, height = 900;
  double azimuth_deg = -58, elevation_deg = 30;  ///< of the camera about the room's middle; 0 = from +x
  int paths = 24;                                ///< the strongest ones, over all receivers; 0 = none
  bool skeletons = true, bodies = true;
};

class Picture {
 public:
  Picture(const Scene& still, std::size_t people, const PictureOptions& options);
  ~Picture();
  /// 8 bits a channel, blue first, as OpenCV has it.
  cv::Mat draw(const ScenePlayer& now) const;

 private:
  class Page;
  RoomView view_;
  std::size_t people_;
  PictureOptions options_;
};

/// A stated scene (scene_file.h) as one that moves.
std::unique_ptr<MovingScene> stated_scene(const Scene& scene);

}  // namespace csipose::sim
