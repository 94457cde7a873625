#include "sim/reflector.h"

#include <cmath>

#include "sim/geometry.h"

namespace csipose::sim {
namespace {

std::complex<double> wave(double amplitude, double length_m, double frequency_hz) {
  return std::polar(amplitude, -2 * kPi * frequency_hz * length_m / kSpeedOfLight_m_s);
}
}  // namespace

ReflectorScene default_reflector_scene(const Band& band) {
  const double spacing_m = band.wavelength_m() / 2;
  ReflectorScene scene;
  for (std::size_t r = 0; r < kReceivers; ++r)
    scene.receivers[r] = {{4.0, 0.5 + 1.25 * static_cast<double>(r), 1.0}, {0, 1, 0}, spacing_m};
  return scene;
}

Vec3 reflector_position(const ReflectorScene& scene, double t_s) {
  const double angle = scene.speed_m_s * t_s / scene.circle_radius_m;
  return scene.circle_centre + scene.circle_radius_m * Vec3{std::cos(angle), std::sin(angle), 0};
}

std::complex<double> line_of_sight(const Vec3& from, const Vec3& to, double frequency_hz,
                                   double wavelength_m) {
  const double length_m = glm::distance(from, to);
  return wave(wavelength_m / (4 * kPi * length_m), length_m, frequency_hz);
}

Channel reflector_channel(const ReflectorScene& scene, const Band& band, double t_s) {
  const Vec3 point = reflector_position(scene, t_s);
  const double lambda_m = band.wavelength_m(), d1 = glm::distance(scene.transmitter, point);
  Channel h;
  for (std::size_t r = 0; r < kReceivers; ++r)
    for (std::size_t a = 0; a < kAntennas; ++a) {
      const Vec3 antenna = scene.receivers[r].element(a);
      const double d2 = glm::distance(point, antenna);
      const double echo = lambda_m * std::sqrt(scene.cross_section_m2) / (std::pow(4 * kPi, 1.5) * d1 * d2);
      for (std::size_t k = 0; k < kSubcarriers; ++k) {
        const double f = band.frequency_hz(k);
        h[r][k][a] = line_of_sight(scene.transmitter, antenna, f, lambda_m) + wave(echo, d1 + d2, f);
      }
    }
  return h;
}

}  // namespace csipose::sim
