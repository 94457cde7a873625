// sim/reference_solver.h - the channel of a scene, the plain way: in double, every antenna exactly, every sum
// in order.
//
// The oracle of the fast solver, and what `csipose-sim solve --reference` runs. Speed is not its business.
#pragma once

#include "sim/scene.h"

namespace csipose::sim {

/// All paths from the transmitter to one antenna with bodies where they are at time t: by walls first, then
/// per body and pair.
std::vector<Path> reference_paths(const Scene& scene, const Antenna& rx, double t_s);

/// Sum of the paths at one frequency.
std::complex<double> transfer(const std::vector<Path>& paths, double frequency_hz);

/// H[snapshot][tone][receiver][antenna], C order.
std::vector<std::complex<double>> solve_reference(const Scene& scene);

}  // namespace csipose::sim
