// daemon/status_view.h - the daemon's status as lines for people: `csipose status` once, `csipose top` every
// second.
#pragma once

#include <vector>

#include "daemon/styled_text.h"
#include "proto/wire.h"

namespace csipose {

std::vector<Line> render_status(const ReceivedStatus& status);

}  // namespace csipose
