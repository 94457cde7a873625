// sim/scene.h - one stated scene: a room, a transmitter, receivers, bodies that move, and what is asked of
// them.
#pragma once

#include <cmath>
#include <memory>
#include <string>
#include <vector>

#include "sim/band.h"
#include "sim/body.h"
#include "sim/clutter.h"
#include "sim/mesh.h"
#include "sim/room.h"
#include "sim/shadow.h"

namespace csipose::sim {

/// A body on a straight course, not turning.
struct MovingBody {
  Body start;
  Vec3 velocity_m_s{};

  Body at(double t_s) const {
    Body body = start;
    body.centre += t_s * velocity_m_s;
    return body;
  }
};

/// A mesh that a scene names, before it is read.
struct MeshUse {
  std::string file;
  MeshImport import;
};
/// A body of any shape, likewise.
struct MeshBody {
  MeshUse use;
  Mesh mesh;  ///< about its own origin; outward
  Vec3 origin{};
  Mat3 axes{1};
  Vec3 velocity_m_s{};
  Surface surface;

  Mesh at(double t_s) const {
    Mesh moved = mesh;
    for (Vec3& p : moved.points) p = origin + t_s * velocity_m_s + axes * p;
    return moved;
  }
};

struct Scene {
  Room room;
  bool walls = true;  ///< false: free space; bodies alone
  Antenna transmitter;
  std::vector<std::vector<Antenna>> receivers;  ///< [receiver][antenna], equally many everywhere
  std::vector<MovingBody> bodies;
  std::vector<Body> furniture;  ///< what stands still
  std::vector<MeshUse>
      mesh_uses;  ///< of rooms and furniture; read_meshes() (mesh_scene.h) makes `meshes` of them
  std::vector<MeshBody> mesh_bodies;            ///< for facet_solver.h alone
  std::shared_ptr<const StillSurfaces> meshes;  ///< if there, waves meet these and not the walls of `room`
  Clutter clutter;                              ///< of the walls; set_clutter() keeps walls and it in step
  double carrier_hz = 5.64e9;
  std::vector<double> tones;  ///< of the subcarriers, in units of kToneSpacing_hz from the carrier
  int wall_order = 3;         ///< most bounces of a path by walls only
  int pairs = 13;  ///< ways between antennas and a body: 1 direct; 13 with one wall before or after; 49 both
  int snapshots = 1;
  double step_s = 1 / 300.0;

  double wavelength_m() const { return kSpeedOfLight_m_s / carrier_hz; }
  void set_clutter(const Clutter& what) {
    clutter = what;
    for (Surface& wall : room.walls) wall.mirrored_share = std::sqrt(1 - what.scattering * what.scattering);
  }
};

/// Every subcarrier that the card reports at 20 MHz.
std::vector<double> intel5300_tones(bool is_40mhz = false);

/// One path at one instant: h(f) = a F e^{-j 2 pi f length / c}.
struct Path {
  double length_m = 0;
  std::complex<double> amplitude;   ///< a: antennas, reflections, spreading
  std::complex<double> shadow = 1;  ///< F: product over legs and bodies
  std::vector<Leg> legs;            ///< in order of travel
  glm::ivec3 image{};               ///< of a path by walls only
  std::vector<Wall> walls;          ///< ... and its walls in order of travel
  int body = -1;         ///< of a path by a body: which, else -1; furniture counts on after the bodies
  bool diffuse = false;  ///< scattered by a tile of a rough wall: neither of the above
  int wall_before = -1, wall_after = -1;  ///< the pair; -1 = direct
  int face = kWholeSurface;
};

}  // namespace csipose::sim
