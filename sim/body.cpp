#include "sim/body.h"

#include <algorithm>
#include <cmath>

#include "sim/geometry.h"
#include "sim/quadrature.h"

namespace csipose::sim {
namespace {
using namespace std::complex_literals;
constexpr int kCapCorners = 64;

/// Two unit vectors that make a right-handed frame with unit w.
std::array<Vec3, 2> across(const Vec3& w) {
  const Vec3 other = std::abs(w.x) < 0.6 ? Vec3{1, 0, 0} : Vec3{0, 1, 0};
  const Vec3 first = glm::normalize(glm::cross(other, w));
  return {first, glm::cross(w, first)};
}

/// Symmetric 2x2.
struct Symmetric2 {
  double xx = 0, xy = 0, yy = 0;
  double determinant() const { return xx * yy - xy * xy; }
};

/// Both legs at a point of the surface.
struct Legs {
  Vec3 e1, e2;  ///< unit, S to point and Q to point
  double s1, s2;
  Legs(const Vec3& s, const Vec3& q, const Vec3& p) : s1(glm::distance(p, s)), s2(glm::distance(p, q)) {
    e1 = (p - s) / s1;
    e2 = (p - q) / s2;
  }
  double length() const { return s1 + s2; }
  /// Second derivative of s1 + s2 along the pair (a, b), before the surface's own curvature.
  double curvature(const Vec3& a, const Vec3& b) const {
    return (glm::dot(a, b) - glm::dot(a, e1) * glm::dot(b, e1)) / s1 +
           (glm::dot(a, b) - glm::dot(a, e2) * glm::dot(b, e2)) / s2;
  }
  bool lights(const Vec3& normal) const { return glm::dot(normal, e1) < 0 && glm::dot(normal, e2) < 0; }
};

/// rho_c = s2 g / (1 - g): the ray tube of spreading A leaves the surface as if it came from so far behind
/// it.
double caustic_distance(double spreading_times_s1, double s2) {
  const double g = std::min(spreading_times_s1, 0.999);
  return s2 * g / (1 - g);
}

// Ellipsoid: P(u) = c + J u with |u| = 1, minimise s1 + s2 over the unit sphere.

struct EllipsoidStep {
  Symmetric2 hessian;
  glm::dvec2 gradient{};
  std::array<Vec3, 2> tangent;
  Vec3 point;
};

EllipsoidStep linearise(const Mat3& j, const Vec3& centre, const Vec3& u, const Vec3& s, const Vec3& q) {
  EllipsoidStep step;
  step.point = centre + j * u;
  step.tangent = across(u);
  const Legs legs(s, q, step.point);
  const Vec3 slope = glm::transpose(j) * (legs.e1 + legs.e2);
  const Vec3 y0 = j * step.tangent[0], y1 = j * step.tangent[1];
  const double inward = glm::dot(u, slope);
  step.gradient = {glm::dot(step.tangent[0], slope), glm::dot(step.tangent[1], slope)};
  step.hessian = {legs.curvature(y0, y0) - inward, legs.curvature(y0, y1), legs.curvature(y1, y1) - inward};
  return step;
}

/// Newton's step where the Hessian bends upwards, downhill otherwise; at most half a radian.
glm::dvec2 descent(const EllipsoidStep& step) {
  const Symmetric2& h = step.hessian;
  const double det = h.determinant();
  glm::dvec2 d = -step.gradient;
  if (det > 0 && h.xx > 0)
    d = glm::dvec2{-(h.yy * step.gradient.x - h.xy * step.gradient.y),
                   -(h.xx * step.gradient.y - h.xy * step.gradient.x)} /
        det;
  const double size = glm::length(d);
  return size > 0.5 ? d * (0.5 / size) : d;
}

Vec3 ellipsoid_minimum(const Mat3& j, const Vec3& centre, const Vec3& s, const Vec3& q) {
  const auto length_at = [&](const Vec3& u) { return Legs(s, q, centre + j * u).length(); };
  Vec3 u = glm::normalize(glm::transpose(j) * (glm::normalize(s - centre) + glm::normalize(q - centre)));
  for (int iteration = 0; iteration < 60; ++iteration) {
    const EllipsoidStep step = linearise(j, centre, u, s, q);
    if (glm::length(step.gradient) < 1e-13) break;
    const glm::dvec2 d = descent(step);
    const double before = length_at(u);
    double fraction = 1;
    Vec3 next = u;
    for (; fraction > 1e-6; fraction /= 2) {
      next = glm::normalize(u + fraction * (d.x * step.tangent[0] + d.y * step.tangent[1]));
      // Close to the minimum a difference of lengths is rounding noise; there Newton's step is right as it
      // is.
      if (length_at(next) <= before + 1e-15 * before || glm::length(d) < 1e-6) break;
    }
    u = next;
  }
  return u;
}

// Flat faces: the mirror image times the share of Fresnel zones that the face's outline leaves.

/// Corners of a face, anticlockwise seen from outside; a disc becomes a polygon.
std::vector<Vec3> corners_of(const Face& face) {
  if (!face.round)
    return {face.middle - face.u - face.v, face.middle + face.u - face.v, face.middle + face.u + face.v,
            face.middle - face.u + face.v};
  std::vector<Vec3> corners;
  for (int i = 0; i < kCapCorners; ++i) {
    const double angle = 2 * kPi * i / kCapCorners;
    corners.push_back(face.middle + std::cos(angle) * face.u + std::sin(angle) * face.v);
  }
  return corners;
}

void reflect_on_face(const Face& face, const Vec3& s, const Vec3& q, const EdgeOptics& optics,
                     std::vector<Reflection>& out) {
  const double height_s = glm::dot(s - face.middle, face.normal),
               height_q = glm::dot(q - face.middle, face.normal);
  if (height_s <= 0 || height_q <= 0) return;
  const Vec3 image = s - 2 * height_s * face.normal;
  const Vec3 point = image + height_s / (height_s + height_q) * (q - image);
  const Legs legs(s, q, point);
  Reflection r{face.id, point, face.normal, legs.s1, legs.s2, -glm::dot(face.normal, legs.e1)};
  r.window = optics.aperture(face, image, q, point);
  r.spreading = r.window / glm::distance(image, q);
  r.caustic_m = legs.s1;
  out.push_back(r);
}

void reflect_on_box(const Body& body, const Vec3& s, const Vec3& q, const EdgeOptics& optics,
                    std::vector<Reflection>& out) {
  for (int axis = 0; axis < 3; ++axis)
    for (int negative = 0; negative < 2; ++negative) {
      const double sign = negative ? -1 : 1;
      const int next = (axis + 1) % 3, last = (axis + 2) % 3;
      const Vec3 outward = sign * body.axes[axis];
      reflect_on_face(
          {2 * axis + negative, outward, body.centre + body.half_m[axis] * outward,
           body.half_m[next] * body.axes[next], sign * body.half_m[last] * body.axes[last], false},
          s, q, optics, out);
    }
}

void reflect_on_caps(const Body& body, const Vec3& s, const Vec3& q, const EdgeOptics& optics,
                     std::vector<Reflection>& out) {
  for (const int id : {kCylinderTop, kCylinderBottom}) {
    const double sign = id == kCylinderTop ? 1 : -1;
    reflect_on_face({id, sign * body.axes[2], body.centre + sign * body.half_m.z * body.axes[2],
                     body.half_m.x * body.axes[0], sign * body.half_m.x * body.axes[1], true},
                    s, q, optics, out);
  }
}

// Cylinder side: a plane problem across the axis; along it the ray runs straight.

/// Angle at which the way from s over a circle of radius r to q is shortest; s and q lie outside the circle.
double circle_minimum(const glm::dvec2& s, const glm::dvec2& q, double radius) {
  // The minimum lies between the directions of s and q, on the shorter way round: Newton's steps, kept in that bracket.
  double low = std::atan2(s.y, s.x), high = low + std::remainder(std::atan2(q.y, q.x) - low, 2 * kPi);
  if (low > high) std::swap(low, high);
  double angle = (low + high) / 2;
  for (int i = 0; i < 60 && high - low > 1e-14; ++i) {
    const glm::dvec2 n{std::cos(angle), std::sin(angle)}, t{-n.y, n.x}, to_s = radius * n - s,
                                                                        to_q = radius * n - q;
    const double rho1 = glm::length(to_s), rho2 = glm::length(to_q);
    const double t1 = glm::dot(t, to_s) / rho1, t2 = glm::dot(t, to_q) / rho2;
    const double slope = t1 + t2;  // of the length, over the radius; below, its derivative
    const double bend = radius * ((1 - t1 * t1) / rho1 + (1 - t2 * t2) / rho2) - glm::dot(n, to_s) / rho1 -
                        glm::dot(n, to_q) / rho2;
    if (std::abs(slope) < 1e-15) break;
    (slope < 0 ? low : high) = angle;
    const double next = bend > 0 ? angle - slope / bend : low;
    angle = next > low && next < high ? next : (low + high) / 2;
  }
  return angle;
}

glm::dvec2 in_cross_section(const Body& body, const Vec3& p) {
  return {glm::dot(p - body.centre, body.axes[0]), glm::dot(p - body.centre, body.axes[1])};
}

void reflect_on_side(const Body& body, const Vec3& s, const Vec3& q, double wavelength_m,
                     const EdgeOptics& optics, std::vector<Reflection>& out) {
  const Vec3& axis = body.axes[2];
  const double radius = body.half_m.x;
  const glm::dvec2 s2d = in_cross_section(body, s), q2d = in_cross_section(body, q);
  if (glm::length(s2d) <= radius || glm::length(q2d) <= radius) return;
  const double angle = circle_minimum(s2d, q2d, radius);
  const Vec3 normal = std::cos(angle) * body.axes[0] + std::sin(angle) * body.axes[1];
  const glm::dvec2 p2d = radius * glm::dvec2{std::cos(angle), std::sin(angle)};
  const double rho1 = glm::distance(s2d, p2d), rho2 = glm::distance(q2d, p2d);
  const double zs = glm::dot(s - body.centre, axis), zq = glm::dot(q - body.centre, axis);
  const double z0 = zs + (zq - zs) * rho1 / (rho1 + rho2);

  const Vec3 point = body.centre + radius * normal + z0 * axis, around = glm::cross(axis, normal);
  const Legs legs(s, q, point);
  if (!legs.lights(normal)) return;
  Reflection r{kCylinderSide, point, normal, legs.s1, legs.s2, -glm::dot(normal, legs.e1)};
  const Symmetric2 h{legs.curvature(around, around) + 2 * r.cos_incidence / radius,
                     legs.curvature(around, axis), legs.curvature(axis, axis)};
  const double infinite = r.cos_incidence / (r.s1_m * r.s2_m * std::sqrt(h.determinant()));
  const double per_metre = std::sqrt(2 * h.determinant() / h.xx / wavelength_m);
  r.window = optics.transition((body.half_m.z - z0) * per_metre) -
             optics.transition((-body.half_m.z - z0) * per_metre);
  r.spreading = infinite * r.window;
  r.caustic_m = caustic_distance(infinite * r.s1_m, r.s2_m);
  out.push_back(r);
}

}  // namespace

double Body::bounding_radius_m() const {
  switch (shape) {
    case Shape::ellipsoid:
      return std::max({half_m.x, half_m.y, half_m.z});
    case Shape::box:
      return glm::length(half_m);
    case Shape::cylinder:
      return std::sqrt(half_m.x * half_m.x + half_m.z * half_m.z);
  }
  return 0;
}

double Body::support_m(const Vec3& w) const {
  const Vec3 local = glm::transpose(axes) * w;
  switch (shape) {
    case Shape::ellipsoid:
      return glm::length(local * half_m);
    case Shape::box:
      return glm::dot(glm::abs(local), half_m);
    case Shape::cylinder:
      return half_m.x * std::sqrt(local.x * local.x + local.y * local.y) + half_m.z * std::abs(local.z);
  }
  return 0;
}

std::optional<Reflection> ellipsoid_reflection(const Body& body, const Vec3& u, const Vec3& s,
                                               const Vec3& q) {
  const Vec3& a = body.half_m;
  const EllipsoidStep at = linearise(stretch_of(body), body.centre, u, s, q);
  const Legs legs(s, q, at.point);
  // The cofactor matrix of J carries the normal, and its length the stretch of area.
  const Vec3 area = body.axes * Vec3{u.x * a.y * a.z, u.y * a.x * a.z, u.z * a.x * a.y};
  const double stretch = glm::length(area), det = at.hessian.determinant();
  Reflection r{kWholeSurface, at.point, area / stretch, legs.s1, legs.s2};
  if (!legs.lights(r.normal) || det <= 0) return std::nullopt;
  r.cos_incidence = -glm::dot(r.normal, legs.e1);
  r.spreading = r.cos_incidence * stretch / (r.s1_m * r.s2_m * std::sqrt(det));
  r.caustic_m = caustic_distance(std::abs(r.spreading) * r.s1_m, r.s2_m);
  return r;
}

void add_edged_reflections(const Body& body, const Vec3& s, const Vec3& q, double wavelength_m,
                           const EdgeOptics& optics, std::vector<Reflection>& out) {
  if (body.shape == Shape::box) return reflect_on_box(body, s, q, optics, out);
  reflect_on_caps(body, s, q, optics, out);
  reflect_on_side(body, s, q, wavelength_m, optics, out);
}

std::vector<Reflection> reflections(const Body& body, const Vec3& s, const Vec3& q, double wavelength_m) {
  std::vector<Reflection> found;
  if (body.shape == Shape::ellipsoid) {
    const Vec3 u = ellipsoid_minimum(stretch_of(body), body.centre, s, q);
    if (const auto r = ellipsoid_reflection(body, u, s, q)) found.push_back(*r);
  } else {
    add_edged_reflections(body, s, q, wavelength_m, ReferenceOptics(wavelength_m), found);
  }
  std::erase_if(found,
                [](const Reflection& r) { return std::abs(r.spreading) * r.s1_m < kWeakestReflection; });
  return found;
}

std::complex<double> ReferenceOptics::aperture(const Face& face, const Vec3& image, const Vec3& q,
                                               const Vec3& point) const {
  const double distance = glm::distance(image, q), k = 2 * kPi / wavelength_m_;
  const auto [ex, ey] = across((q - image) / distance);
  const std::vector<Vec3> corners = corners_of(face);
  std::complex<double> sum = 0;
  for (std::size_t i = 0; i < corners.size(); ++i) {
    const Vec3 from = corners[i], edge = corners[(i + 1) % corners.size()] - from;
    const glm::dvec2 p0{glm::dot(from - point, ex), glm::dot(from - point, ey)},
        dp{glm::dot(edge, ex), glm::dot(edge, ey)};
    const int panels = static_cast<int>(std::ceil(k * glm::length(edge) / 2)) + 1;
    sum += (p0.x * dp.y - p0.y * dp.x) * integrate_unit(panels, [&](double t) {
             const Vec3 p = from + t * edge;
             const glm::dvec2 xy = p0 + t * dp;
             const double detour = glm::distance(p, image) + glm::distance(p, q) - distance;
             // The quotient has a limit where the edge runs through the mirror point: detour falls like rho^2.
             const double rho2 = std::max(glm::dot(xy, xy), 1e-18);
             return (1.0 - std::polar(1.0, -k * detour)) / rho2;
           });
  }
  return sum / (2 * kPi);
}

std::complex<double> ReferenceOptics::transition(double v) const { return edge_transition(v); }

std::complex<double> edge_transition(double v) {
  // Integrate from 0 in panels short against the oscillation e^{-j pi t^2/2}; far out take the asymptotic
  // series.
  constexpr double kFar = 6;
  const double x = std::abs(v);
  std::complex<double> from_zero;
  if (x < kFar) {
    const int panels = 1 + static_cast<int>(x * x / 2 + x);
    from_zero =
        x * integrate_unit(panels, [&](double t) { return std::polar(1.0, -kPi / 2 * x * x * t * t); });
  } else {
    // int_x^inf e^{-j pi t^2/2} dt = e^{-j pi x^2/2} / (j pi x) (1 - 1/(j pi x^2) + 3/(j pi x^2)^2 - ...),
    // A&S 7.3.27
    const std::complex<double> z = 1.0 / (1i * kPi * x * x);
    const std::complex<double> series =
        1.0 - z * (1.0 - z * 3.0 * (1.0 - z * 5.0 * (1.0 - z * 7.0 * (1.0 - z * 9.0))));
    from_zero = (1.0 - 1i) / 2.0 - std::polar(1.0, -kPi / 2 * x * x) / (1i * kPi * x) * series;
  }
  const std::complex<double> half = (1.0 + 1i) / 2.0 * from_zero;
  return v < 0 ? 0.5 - half : 0.5 + half;
}

}  // namespace csipose::sim
