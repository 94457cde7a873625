#include "sim/shadow.h"

#include <algorithm>
#include <cmath>

#include "sim/geometry.h"
#include "sim/quadrature.h"

namespace csipose::sim {
namespace {
using namespace std::complex_literals;

/// (1 - e^{-j pi rho^2 / 2}) / rho^2
std::complex<double> kernel(const Vec2& p) {
  const double rho2 = glm::dot(p, p);
  if (rho2 < 1e-8) return 1i * (kPi / 2);
  return (1.0 - std::polar(1.0, -kPi / 2 * rho2)) / rho2;
}

double cross2(const Vec2& a, const Vec2& b) { return a.x * b.y - a.y * b.x; }

/// Contour integral over the ellipse centre + first cos + second sin.
std::complex<double> ellipse_contour(const Vec2& centre, const Vec2& first, const Vec2& second) {
  const double reach = std::max(glm::length(first), glm::length(second));
  const double rho_max = glm::length(centre) + std::hypot(glm::length(first), glm::length(second));
  const int n = 8 * static_cast<int>(std::ceil((4 * rho_max * reach + 32) / 8));
  std::complex<double> sum = 0;
  for (int i = 0; i < n; ++i) {
    const double c = std::cos(2 * kPi * i / n), s = std::sin(2 * kPi * i / n);
    const Vec2 p = centre + c * first + s * second, dp = c * second - s * first;
    sum += kernel(p) * cross2(p, dp);
  }
  return sum * (2 * kPi / n);
}

std::complex<double> polygon_contour(const std::vector<Vec2>& corners) {
  double rho_max = 0;
  for (const Vec2& p : corners) rho_max = std::max(rho_max, glm::length(p));
  std::complex<double> sum = 0;
  for (std::size_t i = 0; i < corners.size(); ++i) {
    const Vec2 from = corners[i], edge = corners[(i + 1) % corners.size()] - from;
    const int panels = std::max(1, static_cast<int>(std::ceil(kPi * rho_max * glm::length(edge) / 3)));
    sum += cross2(from, edge) * integrate_unit(panels, [&](double t) { return kernel(from + t * edge); });
  }
  return sum;
}

/// Anticlockwise; Andrew's monotone chain.
std::vector<Vec2> convex_hull(std::vector<Vec2> points) {
  std::sort(points.begin(), points.end(),
            [](const Vec2& a, const Vec2& b) { return a.x < b.x || (a.x == b.x && a.y < b.y); });
  std::vector<Vec2> hull;
  const auto extend = [&hull](const Vec2& p, std::size_t keep) {
    while (hull.size() >= keep + 2 && cross2(hull.back() - hull[hull.size() - 2], p - hull.back()) <= 0)
      hull.pop_back();
    hull.push_back(p);
  };
  for (const Vec2& p : points) extend(p, 0);
  const std::size_t lower = hull.size() - 1;
  for (auto p = points.rbegin() + 1; p != points.rend(); ++p) extend(*p, lower);
  hull.pop_back();
  return hull;
}

/// Points whose hull is the solid: a box's corners, or a cylinder's two rims as 96-gons.
std::vector<Vec3> rim_points(const Body& body) {
  constexpr int kRimCorners = 96;
  std::vector<Vec3> points;
  if (body.shape == Shape::box) {
    for (int corner = 0; corner < 8; ++corner) {
      const Vec3 sign{corner & 1 ? 1 : -1, corner & 2 ? 1 : -1, corner & 4 ? 1 : -1};
      points.push_back(body.centre + body.axes * (sign * body.half_m));
    }
    return points;
  }
  for (int i = 0; i < kRimCorners; ++i)
    for (const double end : {-1.0, 1.0}) {
      const double angle = 2 * kPi * i / kRimCorners;
      points.push_back(body.centre + body.axes * (Vec3{std::cos(angle), std::sin(angle), end} * body.half_m));
    }
  return points;
}

void set_across(ShadowView& view) {
  const Vec3 other = std::abs(view.along.x) < 0.6 ? Vec3{1, 0, 0} : Vec3{0, 1, 0};
  view.u = glm::normalize(glm::cross(other, view.along));
  view.v = glm::cross(view.along, view.u);
}

/// `support_m(w)`: the body's reach from its centre along unit w.
template <class Support>
ShadowView shadow_view(const Vec3& centre, double radius, const Leg& leg, double wavelength_m,
                       const Support& support_m) {
  ShadowView v;
  if (leg.is_point()) return v;
  const double length = glm::distance(leg.from, leg.to);
  v.along = (leg.to - leg.from) / length;
  const double x = glm::dot(centre - leg.from, v.along);
  v.off = centre - leg.from - x * v.along;
  const double d1 = std::max(leg.before_m + x, 0.05), d2 = std::max(leg.total_m - leg.before_m - x, 0.05);
  v.per_metre = std::sqrt(2 / wavelength_m * (1 / d1 + 1 / d2));

  // In the open beside a smooth body its reflection already carries the edge wave: the outline's part is blended out.
  const double distance = glm::length(v.off);
  const double reach = distance > 0 ? support_m(v.off / distance) : radius;
  const double open = smooth_step(((distance - reach) * v.per_metre - 2) / 2);
  if (open >= 1) return v;
  // A body behind either end of the leg dims nothing; it fades in as it comes between.
  const double ends =
      smooth_step((x + radius) / (2 * radius)) * smooth_step((length - x + radius) / (2 * radius));
  v.weight = ends * (1 - open);
  set_across(v);
  return v;
}

/// Anticlockwise, scaled, the ray at the origin.
std::vector<Vec2> outline_of(std::span<const Vec3> points, const Leg& leg, const ShadowView& view) {
  std::vector<Vec2> corners;
  for (const Vec3& p : points)
    corners.push_back(view.per_metre * Vec2{glm::dot(p - leg.from, view.u), glm::dot(p - leg.from, view.v)});
  return convex_hull(std::move(corners));
}

std::complex<double> contour_shadow(const Body& body, const Leg& leg, const ShadowView& view) {
  if (body.shape != Shape::ellipsoid) return 1.0 - polygon_contour(hull_outline(body, leg, view)) / (2 * kPi);
  const OutlineEllipse e = ellipsoid_outline(body, view);
  return 1.0 - ellipse_contour(e.centre, e.first, e.second) / (2 * kPi);
}

}  // namespace

double smooth_step(double t) {
  t = std::clamp(t, 0.0, 1.0);
  return t * t * t * (10 - 15 * t + 6 * t * t);
}

ShadowView shadow_view(const Body& body, const Leg& leg, double wavelength_m) {
  return shadow_view(body.centre, body.bounding_radius_m(), leg, wavelength_m,
                     [&body](const Vec3& w) { return body.support_m(w); });
}

OutlineEllipse ellipsoid_outline(const Body& body, const ShadowView& view) {
  // The outline of {J u} across the leg is the ellipse with matrix M = (P J)(P J)^T; its Cholesky factor's columns are a
  // pair of conjugate half axes.
  const Mat3 j = stretch_of(body);
  const Vec3 ju = glm::transpose(j) * view.u, jv = glm::transpose(j) * view.v;
  const double l11 = glm::length(ju), l21 = glm::dot(ju, jv) / l11;
  const double l22 = std::sqrt(std::max(glm::dot(jv, jv) - l21 * l21, 0.0));
  const Vec2 centre{glm::dot(view.off, view.u), glm::dot(view.off, view.v)};
  return {view.per_metre * centre, view.per_metre * Vec2{l11, l21}, view.per_metre * Vec2{0, l22}};
}

std::vector<Vec2> hull_outline(const Body& body, const Leg& leg, const ShadowView& view) {
  return outline_of(rim_points(body), leg, view);
}

std::complex<double> hull_shadow_factor(std::span<const Vec3> points, const Leg& leg, double wavelength_m) {
  Vec3 low = points[0], high = points[0];
  for (const Vec3& p : points) low = glm::min(low, p), high = glm::max(high, p);
  const Vec3 centre = (low + high) / 2.0;
  const auto support_m = [&](const Vec3& w) {
    double reach = 0;
    for (const Vec3& p : points) reach = std::max(reach, glm::dot(p - centre, w));
    return reach;
  };
  double radius = 0;
  for (const Vec3& p : points) radius = std::max(radius, glm::distance(p, centre));
  const ShadowView view = shadow_view(centre, radius, leg, wavelength_m, support_m);
  if (view.weight <= 0) return 1;
  return 1.0 - view.weight / (2 * kPi) * polygon_contour(outline_of(points, leg, view));
}

std::complex<double> contour_shadow(const Body& body, const Leg& leg, double wavelength_m) {
  ShadowView view = shadow_view(body, leg, wavelength_m);
  set_across(view);
  return contour_shadow(body, leg, view);
}

std::complex<double> shadow_factor(const Body& body, const Leg& leg, double wavelength_m) {
  const ShadowView view = shadow_view(body, leg, wavelength_m);
  if (view.weight <= 0) return 1;
  return 1.0 + view.weight * (contour_shadow(body, leg, view) - 1.0);
}

}  // namespace csipose::sim
