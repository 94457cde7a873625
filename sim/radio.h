// sim/radio.h - what an Intel 5300 makes of a channel before anybody sees it.
//
// For packet p, antenna a and subcarrier s the card reports
//
//   X = c_p (g_a e^{j psi_a} B_a(s) H e^{-j 2 pi s D tau_p} e^{j phi_p} + n) + q,   rounded, clamped to 8
//   bits
//
// with H the channel, D the tone spacing, phi_p the carrier phase (the card's oscillator is not the
// sender's), tau_p the delay of packet detection, g and psi the antenna branch, B the passband, n thermal
// noise, c_p the scale that the card's automatic gain leaves, q the noise of the converter. Beside X it
// reports gain, signal strength, a clock of its own and the order of its antennas; it misses packets in
// bursts. docs/simulator.md tells where each range comes from.
//
// Every draw comes from a counter (counter_rng.h): switching one effect off leaves the numbers of the others
// alone.
#pragma once

#include <cstdint>
#include <span>
#include <string_view>

#include "proto/csi_record.h"
#include "sim/band.h"
#include "sim/counter_rng.h"

namespace csipose::sim {

/// Which effects act. None of them: gain, signal strength and rounding to 8 bits remain, since a record has
/// no room for more.
struct Impairments {
  bool carrier_phase = false;    ///< phi_p uniform, anew for each packet and receiver
  bool detection_delay = false;  ///< tau_p: a mean per card
  bool delay_jitter = false;     ///< ... and jitter about it, and now and then a sample slip of 50 ns
  bool branch_gain = false;      ///< g_a, +-3 dB
  bool branch_phase = false;     ///< psi_a, uniform per power-up
  bool passband = false;         ///< B_a: ripple of +-1 dB, roll-off at the band's edges
  bool thermal_noise = false;    ///< n, -92 dBm
  bool converter_noise = false;  ///< q, power 1 in units of the last bit
  bool power_jitter = false;     ///< c_p, +-0.65 dB
  bool antenna_order = false;    ///< chains come in any of six orders
  bool losses = false;           ///< Gilbert-Elliott
  bool channel_access =
      false;  ///< packets leave late, as on a channel that others use too; all receivers see the same
  bool own_clock = false;  ///< each card counts from its own zero, up to 20 ppm fast or slow
  /// 0: the cards are powered up anew for each clip, by its seed and number. N: they are as the N-th powering up left
  /// them, the same for every seed and clip: one installation, recorded again and again.
  std::uint32_t power_up = 0;
};

/// "none": no effect. "mild": a good card in a quiet channel: phase, delay, rounding noise, own clock; no
/// loss. "5300": all of them.
enum class ImpairmentLevel : std::uint8_t { none, mild, intel5300 };
Impairments impairments(ImpairmentLevel level);

/// Every effect by the name of its member above, for switches.
struct NamedImpairment {
  std::string_view name;
  bool Impairments::*member;
};
std::span<const NamedImpairment> named_impairments();

/// Names a packet of a simulation: `number` counts from 0 in its clip.
struct PacketId {
  std::uint64_t seed = 1;
  std::uint32_t clip = 0;
  std::uint32_t number = 0;
  /// The numbers of this packet as `receiver` meets them; kReceivers stands for the transmitter.
  CounterRng rng(std::size_t receiver) const;
};

constexpr std::array<std::array<double, kSubcarriers>, kAntennas> flat_passband() {
  std::array<std::array<double, kSubcarriers>, kAntennas> flat{};
  for (auto& antenna : flat)
    for (double& gain : antenna) gain = 1;
  return flat;
}

/// What a card keeps while it is powered: drawn once per power-up and receiver.
struct Nic {
  double transmit_power_dbm = 15;               ///< of the sender, as this receiver's budget sees it
  std::array<double, kAntennas> gain{1, 1, 1};  ///< voltage
  std::array<double, kAntennas> phase_rad{};
  std::array<std::array<double, kSubcarriers>, kAntennas> passband = flat_passband();  ///< voltage
  double mean_delay_s = 0;
  double csi_power_db = 33;       ///< of X: sum over antennas, mean over subcarriers
  double clock_zero_us = 0;       ///< the card's count at simulated time 0
  double clock_rate = 1;          ///< the card's microseconds per true one
  std::uint16_t first_count = 0;  ///< of the driver's counter
};
Nic draw_nic(const Impairments& on, std::uint64_t seed, std::uint32_t clip, std::size_t receiver);

/// What befalls one packet at one receiver.
struct PacketTrouble {
  double carrier_phase_rad = 0;
  double delay_s = 0;
  double power_offset_db = 0;
  std::array<std::uint8_t, kAntennas> perm{0, 1, 2};  ///< chain j carries antenna perm[j]
};

/// Seconds by which packet `id` leaves later than its place on the grid; the same for all receivers.
double access_delay_s(const Impairments& on, PacketId id);

/// What reaches the card, before its gain.
struct Levels {
  std::array<double, kAntennas> power_dbm{};  ///< at each antenna, mean over subcarriers
  double total_dbm = 0;
};
Levels received_levels(const Nic& nic, const ReceiverChannel& h);
/// agc_db for a total power: what brings it to about -3 dBm at the converter, 0..63.
std::uint8_t agc_for(double total_dbm);
/// rssi with dBm = rssi - 44 - agc (csitool's relation), 0..255.
std::uint8_t rssi_for(double power_dbm, std::uint8_t agc_db);

/// One card. Keeps what lasts from packet to packet: the gain's hysteresis, the channel of losses, the
/// driver's count.
class Radio {
 public:
  /// `rate_hz`: packets a second, which sets how many a burst of loss swallows.
  Radio(const Impairments& on, const Band& band, const Nic& nic, std::size_t receiver, double rate_hz);

  /// Packet `id`, sent at true time `sent_s`, through channel `h`. False when the card misses it. Packets
  /// must come in order, none left out.
  bool receive(PacketId id, double sent_s, const ReceiverChannel& h, CsiRecord& out);
  /// The same with the draws given, and never lost: what a test wants.
  void record(const PacketTrouble& trouble, double sent_s, const ReceiverChannel& h, CounterRng& rng,
              CsiRecord& out);

  const Nic& nic() const { return nic_; }

 private:
  PacketTrouble draw_trouble(CounterRng& rng, double total_dbm) const;
  bool lose(CounterRng& rng);
  std::uint8_t step_agc(double total_dbm);
  void write_header(const PacketTrouble& trouble, const Levels& levels, std::uint8_t agc_db, double sent_s,
                    CsiRecord& out);
  void write_matrix(const PacketTrouble& trouble, const ReceiverChannel& h, CounterRng& rng,
                    CsiRecord& out) const;

  Impairments on_;
  Band band_;
  Nic nic_;
  std::size_t receiver_;
  double leave_bad_, enter_bad_;  ///< per packet, of the loss process
  bool bad_ = false, have_agc_ = false;
  std::uint8_t agc_db_ = 0;
  std::uint16_t count_ = 0;
};

/// The formula at this file's top without scale and noise, in antenna order.
ReceiverChannel distort(const Nic& nic, const PacketTrouble& trouble, const Band& band,
                        const ReceiverChannel& h);
/// c_p: what brings X, the sum over antennas and mean over subcarriers of its power, to the card's usual
/// level.
double csi_scale(const Nic& nic, const PacketTrouble& trouble, const ReceiverChannel& x);

}  // namespace csipose::sim
