// tests/sim/mixed_scene.h - a scene with a body of each kind.
#pragma once

#include "sim/scene_file.h"

namespace csipose::sim {

/// Four bodies in a mixed room, stated here, so that these tests need no file of others.
inline Scene mixed_scene() {
  return parse_scene(R"({
    "dt": 0.00015625, "snapshots": 24, "L": [5.0, 4.2, 2.8], "tx": [0.2, 2.2, 1.1],
    "materials": {"x0": {"name": "concrete"}, "x1": {"name": "plasterboard"}, "y0": {"name": "glass"},
                  "y1": {"name": "wood"}, "z0": {"name": "concrete"}, "z1": {"name": "plasterboard"}},
    "rx": [{"center": [4.8, 1.9, 1.2], "axis": [0, 1, 0]}, {"center": [2.1, 0.2, 1.5], "axis": [1, 0, 0]}],
    "bodies": [
      {"kind": "sphere", "c": [2.5, 2.1, 1.2], "r": 0.25, "mat": "skin_dry", "v": [1.0, 1.5, -0.2]},
      {"kind": "box", "c": [1.5, 3.2, 0.9], "h": [0.2, 0.15, 0.18], "q": [0.3, 0.1, 0.4, 0.8], "mat": "wood", "v": [1.2, -0.9, 0.3]},
      {"kind": "cylinder", "c": [3.8, 1.1, 1.2], "r": 0.15, "hh": 0.3, "q": [0.1, 0.5, 0.0, 0.9], "mat": "metal", "v": [-1.2, 0.8, 0]},
      {"kind": "ellipsoid", "c": [1.7, 1.1, 1.6], "axes": [0.35, 0.2, 0.2], "q": [0.4, -0.2, 0.3, 0.7], "mat": "skin_dry", "v": [0.2, 0.4, 1.4]}]
  })",
                     "mixed");
}

}  // namespace csipose::sim
