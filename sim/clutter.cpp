#include "sim/clutter.h"

#include <algorithm>
#include <cmath>

#include "sim/counter_rng.h"
#include "sim/geometry.h"

namespace csipose::sim {
namespace {
constexpr double kTile_m = 0.5;

double lobe(double cosine, int alpha) { return std::pow((1 + cosine) / 2, alpha); }

/// |R| as the incident polarisation weighs it.
double reflected_share(const Surface& wall, const Vec3& normal, const Vec3& k, const Vec3& field,
                       double wavelength_m) {
  const Fresnel r = wall.reflection(-glm::dot(k, normal), wavelength_m);
  const Vec3 across = glm::cross(k, normal);
  const double size = glm::length(across), all = glm::dot(field, field);
  if (all == 0) return 0;
  const double te = size < 1e-9 ? all : std::pow(glm::dot(field, across / size), 2);
  return std::sqrt((std::norm(r.te) * te + std::norm(r.tm) * (all - te)) / all);
}

/// Unit, across k, in the plane of k and the vertical; nothing along the vertical itself.
Vec3 vertical_across(const Vec3& k) {
  const Vec3 up = Vec3{0, 0, 1} - k.z * k;
  const double length = glm::length(up);
  return length < 1e-9 ? Vec3{0} : up / length;
}

struct Tile {
  Vec3 middle;
  double area_m2;
};

template <class Use>
void for_each_tile(const Room& room, Wall wall, const Use& use) {
  const int axis = axis_of(wall), u = (axis + 1) % 3, v = (axis + 2) % 3;
  const int across = static_cast<int>(std::ceil(room.size_m[u] / kTile_m)),
            along = static_cast<int>(std::ceil(room.size_m[v] / kTile_m));
  const double du = room.size_m[u] / across, dv = room.size_m[v] / along;
  Tile tile{{}, du * dv};
  tile.middle[axis] = plane_of(room, wall);
  for (int i = 0; i < across; ++i)
    for (int j = 0; j < along; ++j) {
      tile.middle[u] = (i + 0.5) * du;
      tile.middle[v] = (j + 0.5) * dv;
      use(tile);
    }
}

}  // namespace

double lobe_integral(int alpha, double cos_incidence) {
  // 2^-alpha sum over j of C(alpha, j) I_j; Degli-Esposti et al., appendix.
  const double sin2 = 1 - cos_incidence * cos_incidence;
  double sum = 0, choose = 1;
  for (int j = 0; j <= alpha; ++j) {
    double part = 1;
    if (j % 2 == 1) {
      double terms = 0, term = 1;  // C(2w, w) sin^(2w) / 4^w
      for (int w = 0; w <= (j - 1) / 2; ++w) {
        terms += term;
        term *= sin2 * (2 * w + 1) / (2.0 * (w + 1));
      }
      part = cos_incidence * terms;
    }
    sum += choose * 2 * kPi / (j + 1) * part;
    choose = choose * (alpha - j) / (j + 1);
  }
  return std::ldexp(sum, -alpha);
}

double scatter_pattern(const Clutter& clutter, const Vec3& normal, const Vec3& k_in, const Vec3& k_out) {
  const double cos_out = glm::dot(k_out, normal), cos_in = -glm::dot(k_in, normal);
  if (cos_out <= 0 || cos_in <= 0) return 0;
  if (clutter.pattern == ScatterPattern::lambertian) return cos_out / kPi;
  const double forward = lobe(glm::dot(mirrored(k_in, normal), k_out), clutter.forward_exponent),
               forward_all = lobe_integral(clutter.forward_exponent, cos_in);
  if (clutter.pattern == ScatterPattern::directive) return forward / forward_all;
  const double share = clutter.forward_share,
               backward = lobe(-glm::dot(k_in, k_out), clutter.backward_exponent);
  return (share * forward + (1 - share) * backward) /
         (share * forward_all + (1 - share) * lobe_integral(clutter.backward_exponent, cos_in));
}

std::vector<ClutterPath> clutter_paths(const Room& room, const Clutter& clutter, const Antenna& tx,
                                       const Antenna& rx, double wavelength_m) {
  std::vector<ClutterPath> paths;
  if (clutter.scattering == 0) return paths;
  for (std::size_t w = 0; w < kWalls; ++w) {
    const Wall wall = static_cast<Wall>(w);
    const Vec3 normal = inward_normal(wall);
    CounterRng rng(clutter.seed, Purpose::clutter, static_cast<std::uint16_t>(w), clutter.clip, 0);
    for_each_tile(room, wall, [&](const Tile& tile) {
      const double phase = rng.uniform(0, 2 * kPi);
      const double s1 = glm::distance(tx.position, tile.middle), s2 = glm::distance(tile.middle, rx.position);
      const Vec3 k_in = (tile.middle - tx.position) / s1, k_out = (rx.position - tile.middle) / s2;
      const Vec3 sent = antenna_field(tx.pattern, tx.axis, k_in);
      const double cos_in = std::max(0.0, -glm::dot(k_in, normal));
      const double strength =
          clutter.scattering * reflected_share(room.surface(wall), normal, k_in, sent, wavelength_m) *
          glm::length(sent) *
          std::sqrt(scatter_pattern(clutter, normal, k_in, k_out) * cos_in * tile.area_m2) / (s1 * s2);
      const double heard = glm::dot(antenna_field(rx.pattern, rx.axis, -k_out), vertical_across(k_out));
      paths.push_back({s1 + s2, wavelength_m / (4 * kPi) * strength * heard * std::polar(1.0, phase)});
    });
  }
  return paths;
}

}  // namespace csipose::sim
