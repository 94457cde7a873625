// sim/room_view.h - a room as a camera outside sees it: near walls and ceiling left away, light from the ceiling, soft shadows.
//
// Rays by Embree, a fixed set of light points and directions: the same scene gives the same picture on any number of threads.
#pragma once

#include <array>
#include <cstdint>
#include <optional>
#include <vector>

#include "sim/ray_scene.h"
#include "sim/scene.h"

namespace csipose::sim {

using Colour = std::array<float, 3>;  ///< red, green, blue, 0..1, linear

/// A pinhole camera; pixels from the top left.
struct Camera {
  Vec3 eye{}, right{1, 0, 0}, up{0, 0, 1}, forward{0, 1, 0};
  double focal_px = 1000;
  glm::dvec2 middle_px{};

  /// Unit.
  Vec3 ray(double x_px, double y_px) const;
  /// Nothing for what lies behind.
  std::optional<glm::dvec2> project(const Vec3& p) const;
};

/// From `azimuth_rad` (about z, 0 = from +x) and `elevation_rad` above the horizon, so near that `extent` just fits into the
/// rectangle of pixels.
Camera camera_around(const Extent& extent, double azimuth_rad, double elevation_rad, glm::dvec2 low_px,
                     glm::dvec2 high_px);

struct Pixels {
  int width = 0, height = 0;
  std::vector<std::uint8_t> rgb;  ///< [row][column][3]; sRGB
};

class RoomView {
 public:
  /// Room, furniture and meshes of `scene`; not its bodies.
  explicit RoomView(const Scene& scene);

  /// Of the room; in free space of antennas and `bodies`.
  Extent extent(const std::vector<Body>& bodies) const;
  /// colours[i] is that of bodies[i]. `paper` is what is seen beside the room.
  Pixels draw(const Camera& camera, int width, int height, const std::vector<Body>& bodies,
              const std::vector<Colour>& colours, const Colour& paper) const;

 private:
  Scene scene_;
  Mesh room_;  ///< normals inward; empty in free space
  RayScene room_rays_;
};

/// A colour for what a body is made of.
Colour colour_of(const Surface& surface, double carrier_hz);

}  // namespace csipose::sim
