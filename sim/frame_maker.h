// sim/frame_maker.h - from bodies in motion to the rows of a data set: physics, radio, arrays.
#pragma once

#include "sim/dataset.h"
#include "sim/fast_solver.h"
#include "sim/receiver_log.h"

namespace csipose::sim {

/// What a data set keeps of each frame.
enum class Storage : std::uint8_t {
  records,  ///< int8 CSI as the card reports it, with signal strength and gain; what was lost is marked
  channel,  ///< complex64 H, before any radio
};

/// The arrays of a frame of kSamples snapshots, but for labels.
std::vector<ArrayPlan> frame_arrays(Storage storage);

/// One snapshot of a solver's H[snapshot][kSubcarriers][kReceivers][kAntennas], as radios take it.
Channel channel_of(std::span<const std::complex<float>> h, std::size_t snapshot);

/// One clip's frames, one after another.
class FrameMaker {
 public:
  /// `scene` without bodies; room, devices and antennas stay for the clip.
  FrameMaker(const Scene& scene, Storage storage, ImpairmentLevel level, std::uint64_t seed,
             std::uint32_t clip, double rate_hz);

  /// bodies[kSamples][body]. Appends one row to each of `rows`, in the order of frame_arrays().
  void add_frame(std::span<const std::vector<Body>> bodies, ClipRows& rows);

 private:
  void append_records(ClipRows& rows);

  Storage storage_;
  std::uint32_t clip_;
  FastSolver solver_;
  ReceiverBank bank_;
  std::vector<std::complex<float>> h_;
};

/// All frames of a sim-object clip.
ClipRows make_object_clip(Storage storage, ImpairmentLevel level, std::uint64_t seed, std::uint32_t clip,
                          std::uint32_t frames, double rate_hz);

}  // namespace csipose::sim
