// sim/walking_scene.h - one person of 1.72 m walks round a room of 4 x 3.5 x 2.6 m at 0.7 m/s, in a circle of 0.9 m about its
// middle; the transmitter at one wall, a receiver at each other, a metre high.
#pragma once

#include <memory>

#include "sim/moving_scene.h"

namespace csipose::sim {

std::unique_ptr<MovingScene> walking_scene(double rate_hz);

}  // namespace csipose::sim
