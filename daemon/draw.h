// daemon/draw.h - a picture of what receivers heard: amplitude and sanitised phase of each antenna over time.
//
// The only part that knows OpenCV, and only of the tool: the daemon never links it.
#pragma once

#include <string>
#include <vector>

#include "capture/features.h"

namespace csipose {

/// One receiver's records, thinned evenly to the picture's width.
struct CsiTrace {
  std::string name;
  std::vector<Features> columns;  ///< oldest first
  std::uint64_t records = 0;      ///< that the columns stand for
};

/// Writes a PNG: per receiver six panels under each other, amplitude of antennas A, B and C in dB against the
/// trace's greatest, then their phase from -pi to pi. Time runs to the right, subcarriers upwards.
/// Throws SetupError when there is nothing to draw or the file cannot be written. The file appears whole or not at all.
void draw_csi(const std::vector<CsiTrace>& traces, const std::string& path);

}  // namespace csipose
