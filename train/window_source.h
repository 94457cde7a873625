// train/window_source.h - what training and evaluation ask of a data set: windows, their people, their clips.
#pragma once

#include <cstdint>
#include <span>
#include <string>

#include "proto/pose.h"
#include "proto/shape.h"

namespace csipose::train {

/// What training asks of a data set. Reading is safe from several threads.
class WindowSource {
 public:
  virtual ~WindowSource() = default;
  virtual std::size_t size() const = 0;
  virtual std::string name() const = 0;
  /// Snapshots that it keeps of a window; where they are fewer than kSamples, read() holds each for its part of the window.
  virtual std::size_t samples() const { return kSamples; }
  /// Writes window i as Window::x, [60][20][9], not normalised.
  virtual void read(std::size_t i, std::span<float> x) const = 0;
  /// Its people in the label frame; empty for a set without labels too.
  virtual std::span<const Skeleton> people(std::size_t i) const = 0;
  /// Name of the installation (room and powered cards) that it was received by; sets of the same installation share it. A set
  /// that does not tell is one of its own.
  virtual std::string room(std::size_t) const { return name(); }
  /// Windows of a clip are much alike: they are held out together.
  virtual std::uint64_t clip(std::size_t i) const = 0;
  /// The same for windows of one clip in whatever folders they are; empty where that is not known.
  virtual std::string clip_name(std::size_t) const { return {}; }
};

}  // namespace csipose::train
