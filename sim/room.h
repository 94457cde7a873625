// sim/room.h - a shoebox room and the paths that bounce off its walls.
//
// The room is [0,Lx] x [0,Ly] x [0,Lz]. Method of images (Allen and Berkley, J. Acoust. Soc. Am. 65 (1979)
// 943), with the field's vector carried along: a path is a straight line from an image of the transmitter,
// folded back into the room at every wall it crosses. In a shoebox every image is seen from everywhere, so no
// path needs a validity test.
#pragma once

#include <cassert>
#include <glm/ext/vector_int3.hpp>
#include <span>
#include <vector>

#include "sim/antenna.h"
#include "sim/fresnel.h"

namespace csipose::sim {

struct Mesh;

enum class Wall : std::uint8_t { x0, x1, y0, y1, z0, z1 };
inline constexpr std::size_t kWalls = 6;
inline constexpr std::array<std::string_view, kWalls> kWallNames{"x0", "x1", "y0", "y1", "z0", "z1"};

struct Room {
  Vec3 size_m{4, 3.5, 2.6};
  std::array<Surface, kWalls> walls{};

  const Surface& surface(Wall wall) const { return walls[static_cast<std::size_t>(wall)]; }
};

inline int axis_of(Wall wall) { return static_cast<int>(wall) / 2; }
/// Into the room.
Vec3 inward_normal(Wall wall);
/// Coordinate of the wall's plane along its axis.
double plane_of(const Room& room, Wall wall);
/// The point behind the wall as far as `p` is before it.
Vec3 mirrored_in(const Room& room, Wall wall, Vec3 p);
/// Where the line through `from` and `to` meets the wall's plane.
Vec3 crossing(const Room& room, Wall wall, const Vec3& from, const Vec3& to);

/// An antenna of one of the devices.
struct Antenna {
  Vec3 position{};
  Vec3 axis{0, 0, 1};
  Pattern pattern = Pattern::hw_dipole;
};

/// One reflection on the way.
struct Bounce {
  Vec3 normal;  ///< unit, on the side of incidence
  Surface surface;
};

/// C_R^T M C_T: antenna fields and reflections along points[0] (transmitter) ... points.back() (receiver); no spreading,
/// no delay. points.size() == normals + 2; `coefficients(i, cosine)` is what reflection i gives back.
template <class Coefficients>
std::complex<double> field_gain(const Antenna& tx, const Antenna& rx, std::span<const Vec3> points,
                                std::span<const Vec3> normals, const Coefficients& coefficients) {
  assert(points.size() == normals.size() + 2);
  Vec3 k = glm::normalize(points[1] - points[0]);
  Field field{antenna_field(tx.pattern, tx.axis, k), {}};
  for (std::size_t i = 0; i < normals.size(); ++i) {
    field = reflected(field, k, normals[i], coefficients(i, -glm::dot(k, normals[i])));
    k = mirrored(k, normals[i]);
  }
  return field.along(antenna_field(rx.pattern, rx.axis, -k));
}
std::complex<double> field_gain(const Antenna& tx, const Antenna& rx, std::span<const Vec3> points,
                                std::span<const Bounce> bounces, double wavelength_m);

/// A path by walls only.
struct WallPath {
  glm::ivec3 index{};        ///< of the transmitter's image: even i at i L + p, odd i at (i+1) L - p
  std::vector<Wall> walls;   ///< in order of travel
  std::vector<Vec3> points;  ///< transmitter, bounces, receiver
  double length_m = 0;
};

/// A path off anything that stands still.
struct StillPath {
  std::vector<Vec3> points;     ///< transmitter, bounces, receiver
  std::vector<Bounce> bounces;  ///< in order of travel
  double length_m = 0;
  WallPath shoebox;  ///< which it is, in a shoebox room
};
/// A room and furniture that are more than a shoebox: meshes (mesh_paths.h).
class StillSurfaces {
 public:
  virtual ~StillSurfaces() = default;
  /// All paths with at most `order` bounces that nothing blocks; the same ones in the same order each time.
  virtual std::vector<StillPath> paths(const Vec3& tx, const Vec3& rx, int order) const = 0;
  /// Whether no surface lies between two points; those that they lie on do not count.
  virtual bool is_open(const Vec3& from, const Vec3& to) const = 0;
  /// What they are, for pictures.
  virtual const Mesh& mesh() const = 0;
};

/// All paths with at most `order` bounces: 1, 7, 25, 63 for 0..3; ordered by image index.
std::vector<WallPath> wall_paths(const Room& room, const Vec3& tx, const Vec3& rx, int order);
/// The path's bounces as field_gain() takes them.
std::vector<Bounce> bounces_of(const Room& room, std::span<const Wall> walls);

}  // namespace csipose::sim
