#include "capture/sanitise.h"

#include <gtest/gtest.h>

#include <cmath>
#include <numbers>
#include <numeric>
#include <string>

#include "proto/intel5300.h"
#include "proto/npy.h"
#include "tests/records.h"
#include "tests/shared_data.h"

namespace csipose {
namespace {

constexpr double kPi = std::numbers::pi;

/// One straight line of phase per antenna, over the counted index k.
StreamCsi straight(double slope_rad, std::array<double, 3> offset_rad) {
  StreamCsi h;
  for (std::size_t antenna = 0; antenna < 3; ++antenna)
    for (std::size_t k = 0; k < kSubcarriers; ++k)
      h[antenna][k] = std::polar(10.0, slope_rad * static_cast<double>(k) + offset_rad[antenna]);
  return h;
}

double turn_distance(double a, double b) { return std::abs(wrap_phase(a - b)); }

TEST(Sanitise, TakesASharedLineOutAndKeepsThePhaseBetweenAntennas) {
  for (const double slope : {-0.9, 0.0, 0.4, 2.0}) {
    const StreamPhase phase = sanitise_joint(straight(slope, {0.3, 0.8, -0.5}));
    const double mean = (0.3 + 0.8 - 0.5) / 3;
    for (std::size_t k = 0; k < kSubcarriers; ++k) {
      EXPECT_NEAR(phase[0][k], 0.3 - mean, 1e-12);
      EXPECT_NEAR(phase[1][k], 0.8 - mean, 1e-12);
      EXPECT_NEAR(phase[2][k], -0.5 - mean, 1e-12);
    }
  }
}

TEST(Sanitise, FitsTheLineThatWasPutIn) {
  const StreamPhase phase = joint_unwrapped(straight(-0.7, {1, 1, 1}));
  const PhaseLine line = fit_line(phase);
  EXPECT_NEAR(line.slope_rad, -0.7, 1e-12);
  EXPECT_NEAR(line.intercept_rad, 1, 1e-12);
}

/// Clock offset and delay of a packet are a line: what is left of the phase must not depend on them.
TEST(Sanitise, GivesTheSamePhaseWhateverLineAPacketBringsAlong) {
  std::mt19937 random(1);
  std::uniform_real_distribution<double> bend(-0.3, 0.3), line(-1, 1);
  StreamPhase room;
  for (auto& antenna : room)
    for (double& p : antenna) p = bend(random);
  const auto received = [&](double slope, double intercept) {
    StreamCsi h;
    for (std::size_t antenna = 0; antenna < 3; ++antenna)
      for (std::size_t k = 0; k < kSubcarriers; ++k)
        h[antenna][k] = std::polar(1.0, room[antenna][k] + slope * static_cast<double>(k) + intercept);
    return sanitise_joint(h);
  };
  const StreamPhase reference = received(0, 0);
  for (int i = 0; i < 100; ++i) {
    const StreamPhase phase = received(line(random), 3 * line(random));
    for (std::size_t antenna = 0; antenna < 3; ++antenna)
      for (std::size_t k = 0; k < kSubcarriers; ++k)
        EXPECT_NEAR(phase[antenna][k], reference[antenna][k], 1e-12);
  }
}

/// The subcarriers' mean number is -0.43 at 20 MHz, not 0, so PhaseFi leaves that much of the slope as a
/// constant.
TEST(Sanitise, TakesOneLineOutOfEachAntennaByPhaseFi) {
  for (const bool is_40mhz : {false, true}) {
    const auto& number = subcarrier_indices(is_40mhz);
    const double mean_number = std::accumulate(number.begin(), number.end(), 0.0) / kSubcarriers;
    StreamCsi h;
    for (std::size_t antenna = 0; antenna < 3; ++antenna)
      for (std::size_t k = 0; k < kSubcarriers; ++k)
        h[antenna][k] = std::polar(5.0, 0.05 * static_cast<double>(antenna + 1) * number[k] + 1.0);
    const StreamPhase phase = sanitise_phasefi(h, is_40mhz);
    for (std::size_t antenna = 0; antenna < 3; ++antenna)
      for (const double p : phase[antenna])
        EXPECT_NEAR(p, -0.05 * static_cast<double>(antenna + 1) * mean_number, 1e-12);
  }
}

/// A record without any CSI is a line already.
TEST(Sanitise, GivesZeroForZeros) {
  for (const auto& antenna : sanitise_joint(StreamCsi{}))
    for (const double phase : antenna) EXPECT_EQ(phase, 0);
}

TEST(Sanitise, WrapsIntoHalfOpenTurn) {
  EXPECT_EQ(wrap_phase(0), 0);
  EXPECT_EQ(wrap_phase(kPi), kPi);
  EXPECT_EQ(wrap_phase(-kPi), kPi);
  EXPECT_NEAR(wrap_phase(3 * kPi / 2), -kPi / 2, 1e-15);
  EXPECT_NEAR(wrap_phase(-9), -9 + 2 * kPi, 1e-15);
}

/// NumPy's rule on its known corner: a step of exactly half a turn is left as it is, in either direction.
TEST(Sanitise, UnwrapsAsNumPyDoes) {
  std::array<double, kSubcarriers> phase{};
  const std::array<double, 7> given = {0, 3, -3, 0, kPi, 0, 4};
  const std::array<double, 7> expected = {0, 3, -3 + 2 * kPi, 2 * kPi, 3 * kPi, 2 * kPi, 4};
  for (std::size_t k = 0; k < kSubcarriers; ++k) phase[k] = given[std::min<std::size_t>(k, 6)];
  unwrap(phase);
  for (std::size_t k = 0; k < 7; ++k) EXPECT_NEAR(phase[k], expected[k], 1e-14) << k;
}

TEST(Sanitise, TakesTheRotationOffTheUpperHalfAtFortyMegahertzOnly) {
  std::mt19937 random(4);
  CsiRecord record = testing::random_record(random);
  const StreamCsi narrow = stream_csi(record, 0, true);
  record.rate |= 0x800;
  const StreamCsi wide = stream_csi(record, 0, true), as_peers = stream_csi(record, 0, false);
  EXPECT_EQ(as_peers, narrow);
  for (std::size_t antenna = 0; antenna < 3; ++antenna) {
    EXPECT_EQ(wide[antenna][14], narrow[antenna][14]);
    EXPECT_EQ(wide[antenna][15], narrow[antenna][15] * std::complex<double>(0, -1));
  }
}

/// A 40 MHz channel is one line only once the rotation is off.
TEST(Sanitise, SeesAStraightFortyMegahertzChannelAsStraight) {
  std::mt19937 random(5);
  CsiRecord record = testing::random_record(random);
  record.rate = 0x901;
  const auto& number = subcarrier_indices(true);
  for (std::size_t k = 0; k < kSubcarriers; ++k)
    for (std::size_t antenna = 0; antenna < 3; ++antenna) {
      const auto c = std::polar(100.0, 0.02 * number[k] + (number[k] > 0 ? kPi / 2 : 0));
      record.csi[CsiRecord::index(k, antenna, 0)] = static_cast<std::int8_t>(std::lround(c.real()));
      record.csi[CsiRecord::index(k, antenna, 0) + 1] = static_cast<std::int8_t>(std::lround(c.imag()));
    }
  for (const auto& antenna : sanitise_joint(stream_csi(record, 0, true)))
    for (const double phase : antenna) EXPECT_NEAR(phase, 0, 0.01);  // quantised to 1/100
  double worst = 0;
  const StreamPhase as_peers = sanitise_joint(stream_csi(record, 0, false));
  for (const double phase : as_peers[0]) worst = std::max(worst, std::abs(phase));
  EXPECT_GT(worst, 0.3);
}

class SanitiseGolden : public ::testing::TestWithParam<const char*> {
 protected:
  std::string base() const { return "csi5300/phase/" + std::string(GetParam()) + "_first100_tx0_"; }
  NpyArray<double> array(const char* what) const {
    return read_npy<double>(testing::shared_data(base() + what + ".npy"));
  }
  std::vector<StreamCsi> first_hundred() const {
    const auto records =
        testing::read_csi(testing::shared_data("csi5300/" + std::string(GetParam()) + ".dat"));
    std::vector<StreamCsi> streams;
    for (std::size_t n = 0; n < 100; ++n) streams.push_back(stream_csi(records[n], 0, true));
    return streams;
  }
  /// Calls compare(record, antenna, k, position in a golden array) where the entry is not zero and unwrapping
  /// is stable.
  template <class Compare>
  void for_each_defined(Compare compare) const {
    const auto mask = read_npy<std::uint8_t>(testing::shared_data(base() + "mask.npy"));
    const auto stable = read_npy<std::uint8_t>(
        testing::shared_data("csi5300/phase/" + std::string(GetParam()) + "_stable_all.npy"));
    std::size_t at = 0, compared = 0;
    for (std::size_t n = 0; n < 100; ++n)
      for (std::size_t antenna = 0; antenna < 3; ++antenna)
        for (std::size_t k = 0; k < kSubcarriers; ++k, ++at)
          if (mask.data[at] != 0 && stable.data[n] != 0) compare(n, antenna, k, at), ++compared;
    EXPECT_GT(compared, 8900u);
  }
};
INSTANTIATE_TEST_SUITE_P(Recordings, SanitiseGolden, ::testing::Values("sample_0x1_ap", "sample_0x5_64_3000"),
                         testing::file_word);

TEST_P(SanitiseGolden, Input) {
  CSIPOSE_NEEDS_SHARED_DATA();
  const auto golden = read_npy<std::complex<float>>(testing::shared_data(base() + "input.npy"));
  const auto h = first_hundred();
  std::size_t at = 0;
  for (const StreamCsi& stream : h)
    for (const auto& antenna : stream)
      for (const auto& entry : antenna) ASSERT_EQ(std::complex<float>(entry), golden.data[at++]);
}

TEST_P(SanitiseGolden, JointAgreesWithPiW3D) {
  CSIPOSE_NEEDS_SHARED_DATA();
  const auto golden = array("piw3d_angle");
  std::vector<StreamPhase> phases;
  for (const StreamCsi& h : first_hundred()) phases.push_back(sanitise_joint(h));
  for_each_defined([&](auto n, auto antenna, auto k, auto at) {
    ASSERT_LT(turn_distance(phases[n][antenna][k], golden.data[at]), 1e-9) << n << ' ' << antenna << ' ' << k;
  });
}

TEST_P(SanitiseGolden, JointUnwrappedPhaseAndFit) {
  CSIPOSE_NEEDS_SHARED_DATA();
  const auto golden = array("joint_unwrapped"), fit = array("joint_fit");
  std::vector<StreamPhase> unwrapped;
  for (const StreamCsi& h : first_hundred()) unwrapped.push_back(joint_unwrapped(h));
  for_each_defined([&](auto n, auto antenna, auto k, auto at) {
    const auto& ours = unwrapped[n];
    const PhaseLine line = fit_line(ours);
    ASSERT_NEAR(ours[antenna][k], golden.data[at], 1e-9);
    ASSERT_NEAR(line.slope_rad, fit.data[2 * n], 1e-9);
    ASSERT_NEAR(line.intercept_rad, fit.data[2 * n + 1], 1e-9);
  });
}

TEST_P(SanitiseGolden, PhaseFi) {
  CSIPOSE_NEEDS_SHARED_DATA();
  const auto golden = array("phasefi");
  std::vector<StreamPhase> phases;
  for (const StreamCsi& h : first_hundred()) phases.push_back(sanitise_phasefi(h, false));
  for_each_defined([&](auto n, auto antenna, auto k, auto at) {
    ASSERT_LT(turn_distance(phases[n][antenna][k], golden.data[at]), 1e-9);
  });
}

/// No step within 1e-6 of half a turn in any of the three unwrappings.
bool is_stable(const StreamCsi& h) {
  const StreamPhase phase = joint_unwrapped(h);
  for (std::size_t antenna = 0; antenna < kAntennas; ++antenna)
    for (std::size_t k = 1; k < kSubcarriers; ++k) {
      const auto before_unwrapping = [&](std::size_t i) {
        if (antenna == 0) return std::arg(h[0][i]);
        return phase[antenna - 1][i] + std::arg(h[antenna][i] * std::conj(h[antenna - 1][i]));
      };
      const double step = std::abs(wrap_phase(before_unwrapping(k) - before_unwrapping(k - 1)));
      if (kPi - step < 1e-6) return false;
    }
  return true;
}

/// The records whose unwrapping hangs on the last bit must be those that the golden list names.
TEST_P(SanitiseGolden, SameRecordsAreStable) {
  CSIPOSE_NEEDS_SHARED_DATA();
  const auto golden = read_npy<std::uint8_t>(
      testing::shared_data("csi5300/phase/" + std::string(GetParam()) + "_stable_all.npy"));
  const auto records = testing::read_csi(testing::shared_data("csi5300/" + std::string(GetParam()) + ".dat"));
  ASSERT_EQ(records.size(), golden.data.size());
  for (std::size_t n = 0; n < records.size(); ++n)
    ASSERT_EQ(is_stable(stream_csi(records[n], 0, true)), golden.data[n] != 0) << "record " << n;
}

}  // namespace
}  // namespace csipose
