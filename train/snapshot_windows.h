// train/snapshot_windows.h - channel matrices of a clip to windows by the daemon's own code: capture/features.h makes the
// numbers of a snapshot, capture/window_builder.h fills what was lost from at most FrontEndConfig::max_gap snapshots before.
#pragma once

#include <memory>

#include "capture/front_end.h"
#include "capture/window_builder.h"

namespace csipose::train {

/// A stream of slots, kSamples a window.
class SnapshotWindows {
 public:
  explicit SnapshotWindows(double grid_hz)
      : builder_({grid_hz, FrontEndConfig{}.max_gap, FrontEndConfig{}.max_skew}) {}

  /// What `receiver` heard of the next window's snapshot t.
  void put(std::size_t t, std::uint8_t receiver, const StreamCsi& h) {
    Sample sample;
    sample.slot = sample.counter = first_slot_ + static_cast<std::int64_t>(t);
    sample.finite = true;
    sample.features = features_of(h, FrontEndConfig{}.phase, false, 1);
    builder_.put(receiver, sample);
  }
  /// The window of what was put; links that lack something are not in Window::links.
  const Window& next() {
    first_slot_ += std::int64_t{kSamples};
    builder_.assemble(first_slot_ - 1, *window_);
    return *window_;
  }

 private:
  WindowBuilder builder_;
  std::int64_t first_slot_ = 0;
  std::unique_ptr<Window> window_ = std::make_unique<Window>();
};

}  // namespace csipose::train
