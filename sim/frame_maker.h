// sim/frame_maker.h - from a room in motion to the rows of a data set: physics, radio, arrays.
#pragma once

#include "sim/dataset.h"
#include "sim/receiver_log.h"
#include "sim/solved_scene.h"

namespace csipose::sim {

/// What a data set keeps of each frame.
enum class Storage : std::uint8_t {
  records,  ///< int8 CSI as the card reports it, with signal strength and gain; what was lost is marked
  channel,  ///< complex64 H, before any radio
  half,     ///< H as pairs of float16, over its rms, which is beside it
};

/// "int8", "complex64", "float16", as options and manifests say.
std::optional<Storage> find_storage(std::string_view name);

/// How a clip's channel becomes rows.
struct FrameFormat {
  Storage storage = Storage::records;
  std::size_t snapshots = kSamples;  ///< of a frame
};

/// The arrays of a frame, but for labels.
std::vector<ArrayPlan> frame_arrays(const FrameFormat& format);

/// One clip's frames, one after another.
class FrameMaker {
 public:
  /// `solver` of the scene's room, devices and antennas, which stay for the clip.
  FrameMaker(FastSolver solver, const FrameFormat& format, const Impairments& on, std::uint64_t seed,
             std::uint32_t clip, double rate_hz);

  /// Takes the next instants of `scene`, whose still() is that of the constructor. Appends one row to each of
  /// `rows`, in the order of frame_arrays().
  void add_frame(MovingScene& scene, ClipRows& rows);
  /// Where people were at snapshot `sample` of the last frame.
  const std::vector<Joints>& people(std::size_t sample) const { return batch_.people(sample); }

 private:
  void append_records(ClipRows& rows);
  void append_half(ClipRows& rows) const;

  FrameFormat format_;
  std::uint32_t clip_;
  ReceiverBank bank_;
  SceneBatch batch_;
};

/// The first `frames` frames of a scene, which is clip `clip` of its set.
ClipRows make_clip(MovingScene& scene, const FrameFormat& format, const Impairments& on, std::uint64_t seed,
                   std::uint32_t clip, std::uint32_t frames, double rate_hz);

}  // namespace csipose::sim
