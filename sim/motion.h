// sim/motion.h - one person over time.
#pragma once

#include <memory>

#include "sim/human.h"

namespace csipose::sim {

/// How a person moves. Any instant can be asked for on its own, in any order: nothing is stepped.
class Motion {
 public:
  virtual ~Motion() = default;
  virtual const Figure& figure() const = 0;
  /// t_s >= 0; past the end of what was planned the person goes on in a way that belongs to the motion.
  virtual Stance at(double t_s) const = 0;
};

}  // namespace csipose::sim
