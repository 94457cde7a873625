#include "sim/room.h"

#include <algorithm>
#include <cassert>
#include <cmath>
#include <cstdlib>

namespace csipose::sim {
namespace {

double image_coordinate(int i, double size, double p) {
  return i % 2 == 0 ? i * size + p : (i + 1) * size - p;
}

Vec3 image_of(const Room& room, const glm::ivec3& index, const Vec3& p) {
  Vec3 image;
  for (int axis = 0; axis < 3; ++axis)
    image[axis] = image_coordinate(index[axis], room.size_m[axis], p[axis]);
  return image;
}

double folded(double x, double size) {
  const double u = x / size, w = u - 2 * std::floor(u / 2);
  return (w > 1 ? 2 - w : w) * size;
}

Vec3 folded(const Room& room, Vec3 p) {
  for (int axis = 0; axis < 3; ++axis) p[axis] = folded(p[axis], room.size_m[axis]);
  return p;
}

struct Crossing {
  double along;  ///< 0 at the image, 1 at the receiver
  Wall wall;
};

/// Planes m L that the line from the image with index i to the receiver crosses.
void add_crossings(const Room& room, int axis, int i, const Vec3& image, const Vec3& rx,
                   std::vector<Crossing>& out) {
  const int first = i > 0 ? 1 : i + 1, last = i > 0 ? i : 0;
  for (int m = first; i != 0 && m <= last; ++m) {
    const double along = (m * room.size_m[axis] - image[axis]) / (rx[axis] - image[axis]);
    out.push_back({along, static_cast<Wall>(2 * axis + std::abs(m % 2))});
  }
}

WallPath unfolded_path(const Room& room, const glm::ivec3& index, const Vec3& tx, const Vec3& rx) {
  const Vec3 image = image_of(room, index, tx);
  std::vector<Crossing> crossings;
  for (int axis = 0; axis < 3; ++axis) add_crossings(room, axis, index[axis], image, rx, crossings);
  std::stable_sort(crossings.begin(), crossings.end(),
                   [](const Crossing& a, const Crossing& b) { return a.along < b.along; });
  WallPath path{index, {}, {tx}, glm::distance(image, rx)};
  for (const Crossing& c : crossings) {
    path.walls.push_back(c.wall);
    path.points.push_back(folded(room, image + c.along * (rx - image)));
  }
  path.points.push_back(rx);
  return path;
}

}  // namespace

Vec3 inward_normal(Wall wall) {
  Vec3 normal{0};
  normal[axis_of(wall)] = static_cast<int>(wall) % 2 == 0 ? 1 : -1;
  return normal;
}

double plane_of(const Room& room, Wall wall) {
  return static_cast<int>(wall) % 2 == 0 ? 0 : room.size_m[axis_of(wall)];
}

Vec3 mirrored_in(const Room& room, Wall wall, Vec3 p) {
  p[axis_of(wall)] = 2 * plane_of(room, wall) - p[axis_of(wall)];
  return p;
}

Vec3 crossing(const Room& room, Wall wall, const Vec3& from, const Vec3& to) {
  const int axis = axis_of(wall);
  return from + (plane_of(room, wall) - from[axis]) / (to[axis] - from[axis]) * (to - from);
}

std::complex<double> field_gain(const Antenna& tx, const Antenna& rx, std::span<const Vec3> points,
                                std::span<const Bounce> bounces, double wavelength_m) {
  std::vector<Vec3> normals;
  for (const Bounce& bounce : bounces) normals.push_back(bounce.normal);
  return field_gain(tx, rx, points, normals, [&](std::size_t i, double cosine) {
    return bounces[i].surface.mirror_reflection(cosine, wavelength_m);
  });
}

std::vector<WallPath> wall_paths(const Room& room, const Vec3& tx, const Vec3& rx, int order) {
  std::vector<WallPath> paths;
  for (int i = -order; i <= order; ++i)
    for (int j = -order; j <= order; ++j)
      for (int l = -order; l <= order; ++l)
        if (std::abs(i) + std::abs(j) + std::abs(l) <= order)
          paths.push_back(unfolded_path(room, {i, j, l}, tx, rx));
  return paths;
}

std::vector<Bounce> bounces_of(const Room& room, std::span<const Wall> walls) {
  std::vector<Bounce> bounces;
  for (const Wall wall : walls) bounces.push_back({inward_normal(wall), room.surface(wall)});
  return bounces;
}

}  // namespace csipose::sim
