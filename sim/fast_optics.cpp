#include "sim/fast_optics.h"

#include <algorithm>
#include <cmath>

#include "sim/geometry.h"

namespace csipose::sim {
namespace {
using namespace std::complex_literals;
constexpr int kFresnelSteps = 1024;
constexpr int kSmallestCircle = 16, kLargestCircle = 256;
constexpr double kTransitionReach = 8;  // beyond, one term of the asymptotic series is 1e-4
constexpr int kTransitionsPerUnit = 256;

std::complex<double> value(const float sum[2]) { return {sum[0], sum[1]}; }
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

/// A vector in the plane across a leg.
struct Flat {
  float x, y;
};
Flat operator+(Flat a, Flat b) { return {a.x + b.x, a.y + b.y}; }
Flat operator-(Flat a, Flat b) { return {a.x - b.x, a.y - b.y}; }
Flat operator*(float k, Flat a) { return {k * a.x, k * a.y}; }
float cross(Flat a, Flat b) { return a.x * b.y - a.y * b.x; }
float dot(Flat a, Flat b) { return a.x * b.x + a.y * b.y; }

EdgePiece edge_piece(Flat from, Flat edge) {
  const float length2 = dot(edge, edge);
  const float t = length2 > 0 ? std::clamp(-dot(from, edge) / length2, 0.0f, 1.0f) : 0;
  const Flat end = from + edge, nearest = from + t * edge;
  const float turning = f(kPi / 2) * (dot(from, from) + dot(end, end) - 2 * dot(nearest, nearest));
  return {from.x, from.y, edge.x, edge.y, panels_for(turning)};
}

/// A box seen along a leg is a zonogon: its half axes, turned into the upper half plane and taken by angle, are half of
/// the outline's edges.
std::array<EdgePiece, 6> box_outline(Flat centre, std::array<Flat, 3> p) {
  for (Flat& axis : p)
    if (axis.y < 0 || (axis.y == 0 && axis.x < 0)) axis = -1.0f * axis;
  std::sort(p.begin(), p.end(), [](Flat a, Flat b) { return cross(a, b) > 0; });
  std::array<EdgePiece, 6> edges;
  Flat corner = centre - p[0] - p[1] - p[2];
  for (std::size_t i = 0; i < 6; ++i) {
    const Flat edge = (i < 3 ? 2.0f : -2.0f) * p[i % 3];
    edges[i] = edge_piece(corner, edge);
    corner = corner + edge;
  }
  return edges;
}

/// A cylinder's outline: half of either rim and the two lines that join them.
struct CylinderOutline {
  std::array<ArcPiece, 2> arcs;
  std::array<EdgePiece, 2> edges;
};

CylinderOutline cylinder_outline(Flat centre, Flat a, Flat b, Flat lift) {
  if (cross(a, b) < 0) b = -1.0f * b;
  // At the angle `start` the rim runs along the lift; the half turn from there belongs to the far rim, the rest to the near.
  const float along = cross(lift, a), aside = cross(lift, b), size = std::sqrt(along * along + aside * aside);
  const Flat first = size > 0 ? (along / size) * a + (aside / size) * b : a;
  const float start = f(std::atan2(aside, along) / (2 * kPi));
  const float width = std::sqrt(std::max(dot(a, a), dot(b, b)));
  const auto arc = [&](Flat middle, float from) {
    const float points =
        2.2f * (std::sqrt(dot(middle, middle)) + std::sqrt(dot(a, a) + dot(b, b))) * width + 16;
    return ArcPiece{{middle.x, middle.y, a.x, a.y, b.x, b.y}, from, 0.5f, panels_for(points / 2)};
  };
  return {{arc(centre - lift, start), arc(centre + lift, start + 0.5f)},
          {edge_piece(centre - first - lift, 2.0f * lift), edge_piece(centre + first + lift, -2.0f * lift)}};
}

void put(ShadowLanes& lanes, std::size_t lane, const LegRow& leg, const BodyRow& body) {
  const float row[9] = {leg.x, leg.y, leg.z, leg.ux, leg.uy, leg.uz, leg.length, leg.before, leg.total};
  for (std::size_t i = 0; i < 9; ++i) lanes.leg[i][lane] = row[i];
  for (std::size_t i = 0; i < 9; ++i) lanes.j[i][lane] = body.j[i];
  for (std::size_t i = 0; i < 3; ++i) lanes.centre[i][lane] = body.centre[i];
  lanes.radius[lane] = body.radius;
  lanes.kind[lane] = static_cast<float>(body.shape);
}

}  // namespace

FresnelTable::FresnelTable(const Surface& surface, double wavelength_m) {
  for (int i = 0; i <= kFresnelSteps; ++i)
    table_.push_back(
        surface.mirror_reflection(std::max(static_cast<double>(i) / kFresnelSteps, 1e-9), wavelength_m));
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

std::size_t CirclePoints::rows() const { return kLargestCircle / kSmallestCircle; }

CirclePoints::Row CirclePoints::row(std::size_t i) const {
  const std::size_t offset = kSmallestCircle * i * (i + 1) / 2;
  return {cosines_.data() + offset, sines_.data() + offset, kSmallestCircle * static_cast<int>(i + 1)};
}

std::size_t CirclePoints::row_for(double wanted) const {
  const int points = static_cast<int>(std::min(wanted, 1.0 * kLargestCircle));
  return static_cast<std::size_t>(std::max(0, (points - 1) / kSmallestCircle));
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
  const auto circle = circle_points().row(circle_points().row_for(
      outline_points({per_metre * Vec2(centre), per_metre * Vec2(a), per_metre * Vec2(b)})));
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

BodyRow body_row(const Body& body) {
  const Mat3 j = stretch_of(body);
  BodyRow row{
      {f(body.centre.x), f(body.centre.y), f(body.centre.z)}, {}, f(body.bounding_radius_m()), body.shape};
  for (int i = 0; i < 9; ++i) row.j[i] = f(j[i / 3][i % 3]);
  return row;
}

LegRow leg_row(const Leg& leg) {
  const double length_m = glm::distance(leg.from, leg.to);
  const Vec3 along = (leg.to - leg.from) / length_m;
  return {f(leg.from.x), f(leg.from.y), f(leg.from.z),   f(along.x),    f(along.y),
          f(along.z),    f(length_m),   f(leg.before_m), f(leg.total_m)};
}

void BodyTable::assign(std::span<const BodyRow> bodies) {
  constexpr float kFarAway_m = 1e6;
  for (auto& column : columns_) column.clear();
  shapes_.clear();
  const auto push = [&](const BodyRow& body) {
    std::size_t c = 0;
    for (const float x : body.centre) columns_[c++].push_back(x);
    for (const float x : body.j) columns_[c++].push_back(x);
    columns_[c++].push_back(body.radius);
    columns_[c].push_back(static_cast<float>(body.shape));
    shapes_.push_back(body.shape);
  };
  for (const BodyRow& body : bodies) push(body);
  while (shapes_.size() % 16 != 0)
    push({{kFarAway_m, kFarAway_m, kFarAway_m}, {1, 0, 0, 0, 1, 0, 0, 0, 1}, 0, Shape::ellipsoid});
}

BodyColumns BodyTable::view() const {
  BodyColumns view{};
  for (std::size_t i = 0; i < 3; ++i) view.centre[i] = columns_[i].data();
  for (std::size_t i = 0; i < 9; ++i) view.j[i] = columns_[3 + i].data();
  view.radius = columns_[12].data();
  view.kind = columns_[13].data();
  view.count = static_cast<int>(shapes_.size());
  return view;
}

std::complex<float> FastOptics::straight_outline(const ShadowLanes& lanes, std::size_t lane,
                                                 Shape shape) const {
  float sum[2], more[2] = {0, 0};
  const Flat centre{lanes.x[lane], lanes.y[lane]};
  const auto axis = [&](std::size_t i) { return Flat{lanes.px[i][lane], lanes.py[i][lane]}; };
  if (shape == Shape::box) {
    const auto edges = box_outline(centre, {axis(0), axis(1), axis(2)});
    kernels_.edges(edges.data(), 6, sum);
  } else {
    const CylinderOutline c = cylinder_outline(centre, axis(0), axis(1), axis(2));
    kernels_.arcs(c.arcs.data(), 2, sum);
    kernels_.edges(c.edges.data(), 2, more);
  }
  return {sum[0] + more[0], sum[1] + more[1]};
}

void FastOptics::begin_shadows(std::size_t count) {
  factors_.assign(count, 1.0f);
  waiting_.resize(circle_points().rows());
}

void FastOptics::integrate(Waiting& waiting, std::size_t row) {
  const auto circle = circle_points().row(row);
  kernels_.ellipses(waiting.lanes, circle.cosines, circle.sines, circle.points);
  for (std::size_t i = 0; i < waiting.count; ++i)
    factors_[waiting.target[i]] *=
        1.0f - waiting.weight[i] * std::complex<float>(waiting.lanes.re[i], waiting.lanes.im[i]);
  waiting.count = 0;
}

void FastOptics::add_view(const ShadowLanes& lanes, std::size_t lane, Shape shape, std::uint32_t target) {
  if (shape != Shape::ellipsoid) {
    factors_[target] *= 1.0f - lanes.weight[lane] * straight_outline(lanes, lane, shape);
    return;
  }
  const std::size_t row = circle_points().row_for(lanes.points[lane]);
  Waiting& waiting = waiting_[row];
  const std::size_t i = waiting.count++;
  waiting.lanes.x[i] = lanes.x[lane], waiting.lanes.y[i] = lanes.y[lane];
  waiting.lanes.ax[i] = lanes.ax[lane], waiting.lanes.ay[i] = lanes.ay[lane];
  waiting.lanes.by[i] = lanes.by[lane];
  waiting.weight[i] = lanes.weight[lane];
  waiting.target[i] = target;
  if (waiting.count == waiting.weight.size()) integrate(waiting, row);
}

void FastOptics::add_shadows(std::span<const Job> jobs) {
  ShadowLanes lanes;
  for (std::size_t first = 0; first < jobs.size(); first += 16) {
    for (std::size_t lane = 0; lane < 16; ++lane) {
      const Job& job = jobs[std::min(first + lane, jobs.size() - 1)];
      put(lanes, lane, *job.leg, *job.body);
    }
    kernels_.shadow_views(lanes, f(2 / wavelength_m_));
    for (std::size_t lane = 0; lane < 16 && first + lane < jobs.size(); ++lane)
      if (lanes.weight[lane] > 0)
        add_view(lanes, lane, jobs[first + lane].body->shape, jobs[first + lane].target);
  }
}

void FastOptics::add_shadows(const LegRow& leg, const BodyTable& bodies, int own, std::uint32_t target) {
  ShadowLanes lanes;
  const BodyColumns columns = bodies.view();
  for (int block = 0; block < columns.count; block += 16) {
    if (!kernels_.leg_views(columns, block, leg, f(2 / wavelength_m_), lanes)) continue;
    for (std::size_t lane = 0; lane < 16; ++lane)
      if (lanes.weight[lane] > 0 && block + static_cast<int>(lane) != own)
        add_view(lanes, lane, bodies.shape(static_cast<std::size_t>(block) + lane), target);
  }
}

std::span<const std::complex<float>> FastOptics::take_shadows() {
  for (std::size_t row = 0; row < waiting_.size(); ++row)
    if (waiting_[row].count > 0) integrate(waiting_[row], row);
  return factors_;
}

}  // namespace csipose::sim
