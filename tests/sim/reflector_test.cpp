#include "sim/reflector.h"

#include <gtest/gtest.h>

#include <cmath>
#include <vector>

#include "sim/geometry.h"

namespace csipose::sim {
namespace {

TEST(LineOfSight, IsFriis) {
  const Band band;
  for (const auto& [distance_m, loss_db] : {std::pair{1.0, -47.473}, {3.0, -57.016}, {10.0, -67.473}}) {
    const auto h = line_of_sight({0, 0, 0}, {distance_m, 0, 0}, band.carrier_hz, band.wavelength_m());
    EXPECT_NEAR(20 * std::log10(std::abs(h)), loss_db, 1e-3) << distance_m;
  }
}

// Without the reflector the phase between two antennas is the path difference and nothing else.
TEST(ReflectorChannel, LineOfSightPhaseBetweenAntennasIsThePathDifference) {
  const Band band;
  ReflectorScene scene = default_reflector_scene(band);
  scene.cross_section_m2 = 0;
  const Channel h = reflector_channel(scene, band, 0);
  for (std::size_t r = 0; r < kReceivers; ++r)
    for (std::size_t k = 0; k < kSubcarriers; ++k) {
      const double difference_m = glm::distance(scene.transmitter, scene.receivers[r].element(2)) -
                                  glm::distance(scene.transmitter, scene.receivers[r].element(0));
      const double expected = -2 * kPi * band.frequency_hz(k) * difference_m / kSpeedOfLight_m_s;
      const double phase = std::arg(h[r][k][2] * std::conj(h[r][k][0]));
      EXPECT_NEAR(std::remainder(phase - expected, 2 * kPi), 0, 1e-9);
    }
}

TEST(ReflectorChannel, EchoObeysTheRadarEquation) {
  const Band band;
  ReflectorScene with = default_reflector_scene(band), without = with;
  without.cross_section_m2 = 0;
  const auto echo =
      reflector_channel(with, band, 0.3)[1][7][2] - reflector_channel(without, band, 0.3)[1][7][2];
  const Vec3 point = reflector_position(with, 0.3);
  const double d1 = glm::distance(with.transmitter, point),
               d2 = glm::distance(point, with.receivers[1].element(2));
  const double lambda = band.wavelength_m();
  EXPECT_NEAR(std::norm(echo) / (lambda * lambda / (std::pow(4 * kPi, 3) * d1 * d1 * d2 * d2)), 1, 1e-9);
}

/// Frequency, Hz, at which the power of `x` has its largest line, searched in steps of 0.02 Hz.
double strongest_line_hz(const std::vector<double>& x, double rate_hz, double up_to_hz) {
  double best = 0, best_hz = 0;
  for (double f = 1; f < up_to_hz; f += 0.02) {
    std::complex<double> sum = 0;
    for (std::size_t n = 0; n < x.size(); ++n) {
      const double window =
          std::pow(std::sin(kPi * (static_cast<double>(n) + 0.5) / static_cast<double>(x.size())), 2);
      sum += window * x[n] * std::polar(1.0, -2 * kPi * f * static_cast<double>(n) / rate_hz);
    }
    if (std::norm(sum) > best) best = std::norm(sum), best_hz = f;
  }
  return best_hz;
}

// |h|^2 beats at the rate with which the reflected path changes its length: v/lambda times the bistatic
// factor.
TEST(ReflectorChannel, PowerBeatsAtTheBistaticDopplerRate) {
  const Band band;
  ReflectorScene scene = default_reflector_scene(band);
  scene.speed_m_s = 2;
  constexpr double kRate_hz = 1000, kFrom_s = 0.067;
  constexpr std::size_t kSamplesTaken = 256;
  std::vector<double> power(kSamplesTaken);
  double mean = 0;
  for (std::size_t n = 0; n < kSamplesTaken; ++n) {
    power[n] =
        std::norm(reflector_channel(scene, band, kFrom_s + static_cast<double>(n) / kRate_hz)[0][15][1]);
    mean += power[n] / kSamplesTaken;
  }
  for (double& p : power) p -= mean;

  const auto path_m = [&](double t) {
    const Vec3 point = reflector_position(scene, t);
    return glm::distance(scene.transmitter, point) + glm::distance(point, scene.receivers[0].element(1));
  };
  const double middle_s = kFrom_s + kSamplesTaken / kRate_hz / 2;
  const double rate_m_s = (path_m(middle_s + 1e-4) - path_m(middle_s - 1e-4)) / 2e-4;
  ASSERT_GT(std::abs(rate_m_s) / band.wavelength_m(), 10);
  EXPECT_NEAR(strongest_line_hz(power, kRate_hz, 100), std::abs(rate_m_s) / band.wavelength_m(), 1.0);
}

TEST(ReflectorPosition, GoesRoundAtItsSpeed) {
  const ReflectorScene scene;
  const double period_s = 2 * kPi * scene.circle_radius_m / scene.speed_m_s;
  EXPECT_NEAR(glm::distance(reflector_position(scene, 0), reflector_position(scene, period_s)), 0, 1e-12);
  EXPECT_NEAR(glm::distance(reflector_position(scene, 0), reflector_position(scene, 1e-6)) / 1e-6,
              scene.speed_m_s, 1e-6);
}

}  // namespace
}  // namespace csipose::sim
