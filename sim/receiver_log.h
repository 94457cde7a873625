// sim/receiver_log.h - three receivers listen to one transmitter, and their drivers write csitool logs.
//
// Every packet that a receiver hears gives a 0xC1 record, whose frame carries the transmit counter, and right
// behind it the 0xBB record with its CSI. A packet that it misses gives neither: the counter shows the gap.
#pragma once

#include <array>
#include <cstdint>
#include <optional>
#include <vector>

#include "sim/radio.h"

namespace csipose::sim {

/// The three receivers of a clip.
class ReceiverBank {
 public:
  /// `session` names the run of the injector in its frames.
  ReceiverBank(const Impairments& on, const Band& band, std::uint64_t seed, std::uint32_t clip,
               double rate_hz);

  /// What each receiver records of one packet; nothing where it missed it.
  struct Heard {
    double sent_s = 0;
    std::array<std::optional<CsiRecord>, kReceivers> records;
  };
  /// Sends the next packet through `channel`, whose place on the grid is packet number / rate.
  Heard hear(const Channel& channel);

  /// Sends the next packet through `channel`, whose place on the grid is packet number / rate. Appends what
  /// each receiver logs of it, or nothing. Returns when it left, in seconds from packet 0's place.
  double send(const Channel& channel, std::array<std::vector<std::uint8_t>, kReceivers>& logs);

  const Radio& radio(std::size_t receiver) const { return radios_[receiver]; }
  std::uint32_t packets_sent() const { return next_.number; }

 private:
  Impairments on_;
  PacketId next_;
  double rate_hz_;
  std::uint16_t session_;
  std::vector<Radio> radios_;
};

}  // namespace csipose::sim
