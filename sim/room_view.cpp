#include "sim/room_view.h"

#include <algorithm>
#include <cmath>
#include <thread>

#include "sim/material.h"

namespace csipose::sim {
namespace {
constexpr int kLightPoints = 32, kSkyDirections = 32,
              kPerPixel = 4;         // each pixel takes a quarter of each, in turn
constexpr double kLift_m = 1e-3;     // off the surface, before looking around
constexpr double kSkyReach_m = 0.7;  // what is farther off dims no corner
constexpr double kGrid_m = 1, kGridLine_m = 0.012;
constexpr Colour kFloor{0.60f, 0.56f, 0.50f}, kWall{0.80f, 0.80f, 0.78f};

Colour operator*(double factor, const Colour& c) {
  const auto x = static_cast<float>(factor);
  return {x * c[0], x * c[1], x * c[2]};
}

std::uint8_t srgb(float linear) {
  const double x = std::clamp(double{linear}, 0.0, 1.0);
  return static_cast<std::uint8_t>(255 * (x <= 0.0031308 ? 12.92 * x : 1.055 * std::pow(x, 1 / 2.4) - 0.055) +
                                   0.5);
}

/// Round the circle by the golden angle, for each pixel's share by itself: each share looks to all sides.
double spread_angle(unsigned i) { return 2.399963 * (i / kPerPixel) + 0.6 * (i % kPerPixel); }

/// What shading asks for.
struct SurfacePoint {
  Vec3 p, normal;
  Colour colour;
};

/// One instant, as rays see it.
class Look {
 public:
  Look(const Scene& scene, const Mesh& room, const RayScene& room_rays, const std::vector<Body>& bodies,
       const std::vector<Colour>& colours, const Extent& extent, const Colour& paper)
      : room_(room), room_rays_(room_rays), bodies_(bodies), colours_(colours), paper_(paper) {
    for (const Body& body : scene.furniture) {
      bodies_.push_back(body);
      colours_.push_back(colour_of(body.surface, scene.carrier_hz));
    }
    for (const Body& body : bodies_) {
      meshes_.push_back(drawn_mesh(body));
      things_.add(meshes_.back());
    }
    things_.commit();
    place_lights(extent);
  }

  /// `turn`: which share of the light points this pixel takes.
  Colour colour_along(const Vec3& origin, const Vec3& direction, unsigned turn) const {
    const auto seen = nearest(origin, direction);
    return seen ? shaded(*seen, direction, turn) : paper_;
  }

 private:
  /// Unit solids are cut once; all bodies of a shape share them.
  static Mesh drawn_mesh(const Body& body) {
    static const Mesh sphere = [] {
      Body unit;
      unit.half_m = Vec3{1};
      return mesh_of(unit, 0.14);
    }();
    if (body.shape != Shape::ellipsoid)
      return mesh_of(body, body.shape == Shape::box ? 1e9 : body.half_m.x / 8);
    Mesh mesh = sphere;
    for (Vec3& p : mesh.points) p = body.centre + body.axes * (body.half_m * p);
    return mesh;
  }

  void place_lights(const Extent& extent) {
    const Vec3 middle = (extent.low + extent.high) / 2.0, size = extent.high - extent.low;
    const double radius = 0.22 * std::min(size.x, size.y);
    for (unsigned i = 0; i < kLightPoints; ++i) {
      const double r = radius * std::sqrt((i + 0.5) / kLightPoints), angle = spread_angle(i);
      lights_.push_back({middle.x - 0.12 * size.x + r * std::cos(angle),
                         middle.y + 0.1 * size.y + r * std::sin(angle), extent.high.z - 0.02});
    }
    for (unsigned i = 0; i < kSkyDirections; ++i) {
      const double u = (i + 0.5) / kSkyDirections, angle = spread_angle(i);  // cosine about z
      sky_.push_back({std::sqrt(u) * std::cos(angle), std::sqrt(u) * std::sin(angle), std::sqrt(1 - u)});
    }
  }

  std::optional<SurfacePoint> nearest(const Vec3& origin, const Vec3& direction) const {
    const auto thing = things_.first_hit(origin, direction);
    const auto wall = inner_wall(origin, direction);
    if (thing && (!wall || thing->distance_m < wall->distance_m)) return on_body(*thing, origin, direction);
    if (wall) return on_wall(*wall, origin, direction);
    return std::nullopt;
  }
  /// Walls seen from behind are left away.
  std::optional<RayScene::Hit> inner_wall(const Vec3& origin, const Vec3& direction) const {
    if (room_.triangles.empty()) return std::nullopt;
    auto hit = room_rays_.first_hit(origin, direction);
    while (hit && glm::dot(room_.area_vector(room_.triangles[hit->triangle]), direction) > 0)
      hit = room_rays_.first_hit(origin, direction, hit->distance_m + kLift_m);
    return hit;
  }
  SurfacePoint on_body(const RayScene::Hit& hit, const Vec3& origin, const Vec3& direction) const {
    const Body& body = bodies_[hit.mesh];
    const Mesh& mesh = meshes_[hit.mesh];
    const Vec3 p = origin + hit.distance_m * direction, local = glm::transpose(body.axes) * (p - body.centre);
    Vec3 normal = glm::normalize(mesh.area_vector(mesh.triangles[hit.triangle]));
    if (body.shape == Shape::ellipsoid)
      normal = glm::normalize(body.axes * (local / (body.half_m * body.half_m)));
    if (body.shape == Shape::cylinder && std::abs(glm::dot(normal, body.axes[2])) < 0.5)
      normal = glm::normalize(body.axes * Vec3{local.x, local.y, 0});
    return {p, normal, colours_[hit.mesh]};
  }
  SurfacePoint on_wall(const RayScene::Hit& hit, const Vec3& origin, const Vec3& direction) const {
    const Vec3 p = origin + hit.distance_m * direction;
    const Vec3 normal = glm::normalize(room_.area_vector(room_.triangles[hit.triangle]));
    if (normal.z < 0.9 || p.z > 0.01) return {p, normal, kWall};
    const auto to_line = [](double x) { return std::abs(x - kGrid_m * std::round(x / kGrid_m)); };
    const bool line = std::min(to_line(p.x), to_line(p.y)) < kGridLine_m / 2;
    return {p, normal, line ? 0.88 * kFloor : kFloor};
  }

  /// 1 where nothing is near in that direction, less the nearer something is.
  double open_share(const Vec3& p, const Vec3& direction) const {
    double open_m = kSkyReach_m;
    if (const auto thing = things_.first_hit(p, direction)) open_m = std::min(open_m, thing->distance_m);
    if (!room_.triangles.empty())
      if (const auto wall = room_rays_.first_hit(p, direction)) open_m = std::min(open_m, wall->distance_m);
    return open_m / kSkyReach_m;
  }

  Colour shaded(const SurfacePoint& at, const Vec3& view, unsigned turn) const {
    const Vec3 p =
        at.p + kLift_m * (at.normal - view);  // back along the ray too: in a corner that is inside for sure
    double light = 0, sky = 0;
    const Vec3 other = std::abs(at.normal.x) < 0.6 ? Vec3{1, 0, 0} : Vec3{0, 1, 0};
    const Vec3 u = glm::normalize(glm::cross(other, at.normal)), v = glm::cross(at.normal, u);
    for (unsigned i = turn % kPerPixel; i < kLightPoints; i += kPerPixel) {
      const Vec3 to = lights_[i] - p;
      const double cosine = glm::dot(glm::normalize(to), at.normal);
      if (cosine > 0 && !things_.is_blocked(p, lights_[i], kLift_m))
        light += cosine * kPerPixel / kLightPoints;
    }
    for (unsigned i = turn % kPerPixel; i < kSkyDirections; i += kPerPixel) {
      const Vec3 direction = sky_[i].x * u + sky_[i].y * v + sky_[i].z * at.normal;
      sky += open_share(p, glm::normalize(direction)) * kPerPixel / kSkyDirections;
    }
    const double from_above = 0.85 + 0.15 * at.normal.z;
    const double from_camera = std::max(0.0, -glm::dot(view, at.normal));
    return (0.55 * light + 0.50 * sky * from_above + 0.10 * from_camera + 0.05) * at.colour;
  }

  const Mesh& room_;
  const RayScene& room_rays_;
  std::vector<Body> bodies_;
  std::vector<Colour> colours_;
  Colour paper_;
  std::vector<Mesh> meshes_;
  RayScene things_;
  std::vector<Vec3> lights_, sky_;
};

/// Rows are dealt out by turns; each is computed alike whoever computes it.
template <class Row>
void for_all_rows(int rows, Row row) {
  const int threads = std::max(1, static_cast<int>(std::thread::hardware_concurrency()));
  std::vector<std::thread> pool;
  for (int t = 0; t < threads; ++t)
    pool.emplace_back([=] {
      for (int y = t; y < rows; y += threads) row(y);
    });
  for (std::thread& thread : pool) thread.join();
}

Mesh room_mesh(const Scene& scene) {
  Mesh mesh;
  if (scene.meshes)
    mesh = scene.meshes->mesh();
  else if (scene.walls)
    mesh = mesh_of(scene.room, {});
  return mesh;
}

std::array<Vec3, 8> corners_of(const Extent& e) {
  std::array<Vec3, 8> corners;
  for (std::size_t i = 0; i < 8; ++i)
    corners[i] = {i & 1 ? e.high.x : e.low.x, i & 2 ? e.high.y : e.low.y, i & 4 ? e.high.z : e.low.z};
  return corners;
}

}  // namespace

Vec3 Camera::ray(double x_px, double y_px) const {
  return glm::normalize(focal_px * forward + (x_px - middle_px.x) * right - (y_px - middle_px.y) * up);
}

std::optional<glm::dvec2> Camera::project(const Vec3& p) const {
  const Vec3 to = p - eye;
  const double depth = glm::dot(to, forward);
  if (depth <= 1e-6) return std::nullopt;
  return glm::dvec2{middle_px.x + focal_px * glm::dot(to, right) / depth,
                    middle_px.y - focal_px * glm::dot(to, up) / depth};
}

Camera camera_around(const Extent& extent, double azimuth_rad, double elevation_rad, glm::dvec2 low_px,
                     glm::dvec2 high_px) {
  const Vec3 from{std::cos(elevation_rad) * std::cos(azimuth_rad),
                  std::cos(elevation_rad) * std::sin(azimuth_rad), std::sin(elevation_rad)};
  Camera camera;
  camera.forward = -from;
  camera.right = glm::normalize(glm::cross(camera.forward, Vec3{0, 0, 1}));
  camera.up = glm::cross(camera.right, camera.forward);
  const Vec3 middle = (extent.low + extent.high) / 2.0;
  camera.eye =
      middle + 2.1 * glm::distance(extent.low, extent.high) * from;  // a longish lens: little distortion
  // With the eye fixed, focal length and offset follow from the outline: it fills the rectangle on one side.
  camera.focal_px = 1;
  glm::dvec2 low{1e9}, high{-1e9};
  const double nearest =
      std::abs(from.x * (extent.high.x - middle.x)) + std::abs(from.y * (extent.high.y - middle.y));
  for (const Vec3& corner : corners_of(extent)) {
    // The upper corner on this side belongs to walls that are left away.
    if (corner.z == extent.high.z && glm::dot(corner - middle, {from.x, from.y, 0}) > 0.9 * nearest) continue;
    const glm::dvec2 at = *camera.project(corner);
    low = glm::min(low, at), high = glm::max(high, at);
  }
  const glm::dvec2 ratio = (high_px - low_px) / (high - low);
  camera.focal_px = std::min(ratio.x, ratio.y);
  camera.middle_px = (low_px + high_px) / 2.0 - camera.focal_px * (low + high) / 2.0;
  return camera;
}

RoomView::RoomView(const Scene& scene) : scene_(scene), room_(room_mesh(scene)) {
  scene_.bodies.clear();
  if (room_.triangles.empty()) return;
  if (check(room_).volume_m3 > 0) turn_over(room_);
  room_rays_.add(room_);
  room_rays_.commit();
}

Extent RoomView::extent(const std::vector<Body>& bodies) const {
  if (!room_.points.empty()) return extent_of(room_);
  Mesh points;
  points.points.push_back(scene_.transmitter.position);
  for (const auto& receiver : scene_.receivers)
    for (const Antenna& antenna : receiver) points.points.push_back(antenna.position);
  for (const Body& body : bodies)
    for (const double sign : {-1.0, 1.0})
      points.points.push_back(body.centre + sign * body.bounding_radius_m());
  Extent e = extent_of(points);
  return {e.low - 0.2, e.high + 0.2};
}

Pixels RoomView::draw(const Camera& camera, int width, int height, const std::vector<Body>& bodies,
                      const std::vector<Colour>& colours, const Colour& paper) const {
  const Look look(scene_, room_, room_rays_, bodies, colours, extent(bodies), paper);
  Pixels out{
      width, height,
      std::vector<std::uint8_t>(static_cast<std::size_t>(width) * static_cast<std::size_t>(height) * 3)};
  for_all_rows(height, [&](int y) {
    for (int x = 0; x < width; ++x) {
      const unsigned turn = static_cast<unsigned>(x % 2 + 2 * (y % 2));
      const Colour c = look.colour_along(camera.eye, camera.ray(x + 0.5, y + 0.5), turn);
      for (std::size_t i = 0; i < 3; ++i)
        out.rgb[(static_cast<std::size_t>(y) * static_cast<std::size_t>(width) +
                 static_cast<std::size_t>(x)) *
                    3 +
                i] = srgb(c[i]);
    }
  });
  return out;
}

Colour colour_of(const Surface& surface, double carrier_hz) {
  const auto is = [&](const char* name) {
    return find_material(name)->permittivity(carrier_hz) == surface.eta;
  };
  if (is("skin_dry") || is("skin_wet") || is("muscle")) return {0.72f, 0.43f, 0.32f};
  if (is("metal")) return {0.45f, 0.48f, 0.52f};
  if (is("wood") || is("chipboard") || is("plywood") || is("floorboard")) return {0.52f, 0.33f, 0.17f};
  if (is("glass")) return {0.42f, 0.62f, 0.66f};
  return {0.55f, 0.54f, 0.52f};
}

}  // namespace csipose::sim
