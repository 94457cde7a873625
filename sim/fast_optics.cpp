#include "sim/fast_optics.h"

#include <algorithm>
#include <cmath>
#include <numbers>

namespace csipose::sim {
namespace {
using namespace std::complex_literals;
constexpr double kPi = std::numbers::pi;
constexpr int kFresnelSteps = 1024;
constexpr int kSmallestCircle = 16, kLargestCircle = 256;
constexpr double kTransitionReach = 8;  // beyond, one term of the asymptotic series is 1e-4
constexpr int kTransitionsPerUnit = 256;

std::complex<double> value(const float sum[2]) { return {sum[0], sum[1]}; }
float f(double x) { return static_cast<float>(x); }

/// An even number of 8-point panels for a phase that turns by `radians`: six radians each.
int panels_for(double radians) { return 2 * std::clamp(static_cast<int>(std::ceil(radians / 12)), 1, 32); }

/// How much a quadratic phase scale * rho^2 turns along a straight edge.
double turning(const Vec2& from, const Vec2& edge, double scale) {
  const double a = glm::dot(from, from), b = glm::dot(from + edge, from + edge);
  const double t = std::clamp(-glm::dot(from, edge) / glm::dot(edge, edge), 0.0, 1.0);
  const Vec2 nearest = from + t * edge;
  return scale * (a + b - 2 * glm::dot(nearest, nearest));
}

/// Points of a closed smooth outline: the phase pi/2 rho^2 turns fastest where it is far and large.
double outline_points(const OutlineEllipse& e) {
  const double first2 = glm::dot(e.first, e.first), second2 = glm::dot(e.second, e.second);
  const double reach = std::sqrt(first2 + second2);
  return 2.2 * (glm::length(e.centre) + reach) * std::sqrt(std::max(first2, second2)) + 16;
}

EllipseOutline as_floats(const OutlineEllipse& e) {
  return {f(e.centre.x), f(e.centre.y), f(e.first.x), f(e.first.y), f(e.second.x), f(e.second.y)};
}

double cross2(const Vec2& a, const Vec2& b) { return a.x * b.y - a.y * b.x; }

/// A cylinder's outline: half of either rim and the two lines that join them.
struct CylinderOutline {
  std::array<ArcPiece, 2> arcs;
  std::array<EdgePiece, 2> edges;
};

EdgePiece edge_piece(const Vec2& from, const Vec2& to) {
  const Vec2 edge = to - from;
  const double radians = glm::dot(edge, edge) > 0 ? turning(from, edge, kPi / 2) : 0;
  return {f(from.x), f(from.y), f(edge.x), f(edge.y), panels_for(radians)};
}

CylinderOutline cylinder_outline(const Body& body, const ShadowView& view) {
  const auto across = [&](const Vec3& p) {
    return view.per_metre * Vec2{glm::dot(p, view.u), glm::dot(p, view.v)};
  };
  const Vec2 centre = across(view.off), lift = across(body.half_m.z * body.axes[2]);
  const Vec2 a = across(body.half_m.x * body.axes[0]);
  Vec2 b = across(body.half_m.x * body.axes[1]);
  if (cross2(a, b) < 0) b = -b;
  // At the angle `start` the rim runs along the lift; the half turn from there belongs to the far rim, the rest to the near.
  const double start = std::atan2(cross2(lift, b), cross2(lift, a)) / (2 * kPi);
  const Vec2 first = std::cos(2 * kPi * start) * a + std::sin(2 * kPi * start) * b;
  const auto arc = [&](const Vec2& middle, double from) {
    const OutlineEllipse e{middle, a, b};
    return ArcPiece{as_floats(e), f(from), 0.5f, panels_for(outline_points(e) / 2)};
  };
  return {{arc(centre - lift, start), arc(centre + lift, start + 0.5)},
          {edge_piece(centre - first - lift, centre - first + lift),
           edge_piece(centre + first + lift, centre + first - lift)}};
}

}  // namespace

FresnelTable::FresnelTable(const Surface& surface, double wavelength_m) {
  for (int i = 0; i <= kFresnelSteps; ++i)
    table_.push_back(
        surface.reflection(std::max(static_cast<double>(i) / kFresnelSteps, 1e-9), wavelength_m));
}

Fresnel FresnelTable::at(double cos_incidence) const {
  const double x = std::clamp(cos_incidence, 0.0, 1.0) * kFresnelSteps;
  const auto i = std::min(static_cast<std::size_t>(x), static_cast<std::size_t>(kFresnelSteps - 1));
  const double t = x - static_cast<double>(i);
  const Fresnel &a = table_[i], &b = table_[i + 1];
  return {a.te + t * (b.te - a.te), a.tm + t * (b.tm - a.tm)};
}

CirclePoints::CirclePoints() {
  for (int n = kSmallestCircle; n <= kLargestCircle; n += kSmallestCircle)
    for (int i = 0; i < n; ++i) {
      cosines_.push_back(f(std::cos(2 * kPi * i / n)));
      sines_.push_back(f(std::sin(2 * kPi * i / n)));
    }
}

CirclePoints::Row CirclePoints::at_least(double wanted) const {
  const int rows =
      std::clamp(static_cast<int>(std::ceil(wanted / kSmallestCircle)), 1, kLargestCircle / kSmallestCircle);
  const int offset = kSmallestCircle * rows * (rows - 1) / 2;
  return {cosines_.data() + offset, sines_.data() + offset, kSmallestCircle * rows};
}

const CirclePoints& circle_points() {
  static const CirclePoints points;
  return points;
}

FastOptics::FastOptics(const FastKernels& kernels, double wavelength_m)
    : kernels_(kernels), wavelength_m_(wavelength_m) {
  const int count = static_cast<int>(2 * kTransitionReach) * kTransitionsPerUnit;
  for (int i = 0; i <= count; ++i)
    transitions_.push_back(edge_transition(static_cast<double>(i) / kTransitionsPerUnit - kTransitionReach));
}

std::complex<double> FastOptics::transition(double v) const {
  if (std::abs(v) >= kTransitionReach) {
    const auto tail = (1.0 + 1i) / 2.0 * std::polar(1.0, -kPi / 2 * v * v) / (1i * kPi * v);
    return v > 0 ? 1.0 - tail : -tail;
  }
  const double x = (v + kTransitionReach) * kTransitionsPerUnit;
  const auto i = std::min(static_cast<std::size_t>(x), transitions_.size() - 2);
  return transitions_[i] + (x - static_cast<double>(i)) * (transitions_[i + 1] - transitions_[i]);
}

std::complex<double> FastOptics::aperture(const Face& face, const Vec3& image, const Vec3& q,
                                          const Vec3& point) const {
  const Vec3 along = glm::normalize(q - image);
  const Vec3 other = std::abs(along.x) < 0.6 ? Vec3{1, 0, 0} : Vec3{0, 1, 0};
  const Vec3 ex = glm::normalize(glm::cross(other, along)), ey = glm::cross(along, ex);
  const MirrorRay ray{f(glm::distance(image, point)), f(glm::distance(point, q)), f(2 * kPi / wavelength_m_)};
  if (!face.round) return rectangle(face, ex, ey, along, point, ray);

  const Vec3 c = face.middle - point;
  const auto row = [&](const Vec3& p) { return Vec3{glm::dot(p, ex), glm::dot(p, ey), glm::dot(p, along)}; };
  const Vec3 centre = row(c), a = row(face.u), b = row(face.v);
  const double per_metre = std::sqrt(2 / wavelength_m_ * (1.0 / ray.d1 + 1.0 / ray.d2));
  const auto circle = circle_points().at_least(
      outline_points({per_metre * Vec2(centre), per_metre * Vec2(a), per_metre * Vec2(b)}));
  float sum[2];
  kernels_.rim({f(centre.x), f(centre.y), f(centre.z), f(a.x), f(a.y), f(a.z), f(b.x), f(b.y), f(b.z)}, ray,
               circle.cosines, circle.sines, circle.points, sum);
  return value(sum);
}

std::complex<double> FastOptics::rectangle(const Face& face, const Vec3& ex, const Vec3& ey,
                                           const Vec3& along, const Vec3& point, const MirrorRay& ray) const {
  const double phase_per_m2 = kPi / wavelength_m_ * (1.0 / ray.d1 + 1.0 / ray.d2);
  const Vec3 c = face.middle - point;
  const std::array<Vec3, 4> from{c - face.u - face.v, c + face.u - face.v, c + face.u + face.v,
                                 c - face.u + face.v};
  std::array<FaceEdge, 4> edges;
  for (std::size_t i = 0; i < 4; ++i) {
    const Vec3 edge = from[(i + 1) % 4] - from[i];
    const Vec2 p{glm::dot(from[i], ex), glm::dot(from[i], ey)}, d{glm::dot(edge, ex), glm::dot(edge, ey)};
    edges[i] = {f(p.x),
                f(p.y),
                f(glm::dot(from[i], along)),
                f(d.x),
                f(d.y),
                f(glm::dot(edge, along)),
                panels_for(turning(p, d, phase_per_m2))};
  }
  float sum[2];
  kernels_.face(edges.data(), 4, ray, sum);
  return value(sum);
}

std::complex<double> FastOptics::outline(const Body& body, const Leg& leg, const ShadowView& view) const {
  float sum[2], more[2];
  if (body.shape == Shape::ellipsoid) {
    const OutlineEllipse e = ellipsoid_outline(body, view);
    const auto circle = circle_points().at_least(outline_points(e));
    kernels_.ellipse(as_floats(e), circle.cosines, circle.sines, circle.points, sum);
    return value(sum);
  }
  if (body.shape == Shape::cylinder) {
    const CylinderOutline c = cylinder_outline(body, view);
    kernels_.arcs(c.arcs.data(), 2, sum);
    kernels_.edges(c.edges.data(), 2, more);
    return value(sum) + value(more);
  }
  const std::vector<Vec2> corners = hull_outline(body, leg, view);
  std::array<EdgePiece, 8> pieces;
  for (std::size_t i = 0; i < corners.size(); ++i)
    pieces[i] = edge_piece(corners[i], corners[(i + 1) % corners.size()]);
  kernels_.edges(pieces.data(), static_cast<int>(corners.size()), sum);
  return value(sum);
}

std::complex<double> FastOptics::shadow(const Body& body, const Leg& leg) const {
  const ShadowView view = shadow_view(body, leg, wavelength_m_);
  if (view.weight <= 0) return 1;
  return 1.0 - view.weight * outline(body, leg, view);
}

}  // namespace csipose::sim
