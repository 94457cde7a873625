// daemon/csi_trace.h - the records of a file thinned to as many columns as a picture has.
#pragma once

#include <string>
#include <vector>

#include "daemon/draw.h"

namespace csipose {

inline constexpr std::size_t kPictureColumns = 1200;

/// Features (raw amplitude, joint phase, stream 0) of every receiver's usable records, evenly thinned to at most `columns`.
/// Throws SetupError when the file cannot be read.
std::vector<CsiTrace> trace_csi(const std::string& path, std::size_t columns);

}  // namespace csipose
