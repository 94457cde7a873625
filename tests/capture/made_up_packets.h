// tests/capture/made_up_packets.h - packets of receivers whose every fault is known, and packets of
// recordings.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <functional>
#include <random>
#include <vector>

#include "capture/front_end.h"
#include "proto/frame_record.h"
#include "proto/intel5300.h"

namespace csipose::testing {

/// A packet that owns its bytes.
struct StoredPacket {
  std::uint8_t receiver = 0;
  SteadyTime arrival{};
  std::vector<std::uint8_t> bytes;
  std::int64_t truth = -1;  ///< index of the transmitted frame

  Packet packet() const {
    constexpr std::int64_t kUtcOffsetNs = 1'700'000'000'000'000'000;
    return {receiver, arrival, UtcTime{Nanoseconds{ns(arrival) + kUtcOffsetNs}}, ByteView(bytes)};
  }
};

/// CSI that tells which receiver measured which frame: amplitude of subcarrier 0 is tag(receiver, frame) at
/// every antenna.
inline int tag(std::uint8_t receiver, std::int64_t frame) {
  return 1 + static_cast<int>((frame * 3 + receiver) % 120);
}

inline CsiRecord made_up_csi(std::uint8_t receiver, std::int64_t frame) {
  CsiRecord record;
  record.nrx = 3;
  record.ntx = 1;
  record.rssi = {30, 32, 34};
  record.noise_dbm = -92;
  record.agc_db = 40;
  record.antenna_sel = 0x24;
  record.rate = 0x4101 & 0x3FFF;
  record.perm_valid = true;
  for (std::size_t a = 0; a < kAntennas; ++a)
    for (std::size_t k = 0; k < kSubcarriers; ++k) {
      const double phase_rad = 0.2 * static_cast<double>(k) + 0.4 * static_cast<double>(a);
      record.csi[CsiRecord::index(k, a, 0)] = static_cast<std::int8_t>(std::lround(90 * std::cos(phase_rad)));
      record.csi[CsiRecord::index(k, a, 0) + 1] =
          static_cast<std::int8_t>(std::lround(90 * std::sin(phase_rad)));
    }
  for (std::size_t a = 0; a < kAntennas; ++a) {
    record.csi[CsiRecord::index(0, a, 0)] = static_cast<std::int8_t>(tag(receiver, frame));
    record.csi[CsiRecord::index(0, a, 0) + 1] = 0;
  }
  return record;
}

/// One receiver and all that is wrong with it.
struct MadeUpReceiver {
  double offset_us = 0;  ///< NIC clock at time 0
  double skew_ppm = 0;
  double loss = 0;               ///< probability of losing a frame on the air
  double path_ms = 0.2;          ///< shortest way to the host
  double jitter_ms = 0;          ///< mean of an exponential delay on top
  std::uint16_t bfee_count = 0;  ///< of its first record
  std::function<bool(std::int64_t frame)> deaf = [](std::int64_t) { return false; };
};

/// How the transmitter sends and what it says.
struct MadeUpTransmitter {
  double hz = 300;
  std::int64_t frames = 600;
  double access_jitter_us = 0;  ///< standard deviation of channel access, the same for all receivers
  std::function<double(std::int64_t frame)> pause_s = [](std::int64_t) { return 0.0; };  ///< before a frame
  /// Bytes of the 0xC1 record; empty = none is logged.
  std::function<std::vector<std::uint8_t>(std::int64_t frame)> frame_record;
  double start_s = 100;  ///< host clock
};

inline std::vector<std::uint8_t> csip_frame(std::uint64_t counter, std::uint16_t session = 1) {
  const auto bytes = encode_csip_record({session, counter, 0});
  return {bytes.begin(), bytes.end()};
}
/// A frame whose sequence control counts: all 16 bits, as csiread's injector does.
inline std::vector<std::uint8_t> sequence16_frame(std::uint64_t counter) {
  const auto header = injector_header(static_cast<std::uint16_t>(counter));
  std::vector<std::uint8_t> frame(header.begin(), header.end());
  frame.resize(100, 0x55);
  return encode_frame_record(ByteView(frame));
}
inline std::vector<std::uint8_t> no_frame(std::int64_t) { return {}; }

/// All packets in the order of their arrival (of the host's clock; ties by receiver). One receiver's never
/// overtake.
inline std::vector<StoredPacket> make_packets(const MadeUpTransmitter& transmitter,
                                              const std::vector<MadeUpReceiver>& receivers,
                                              unsigned seed = 1) {
  std::mt19937 random(seed);
  std::normal_distribution<double> access(0, transmitter.access_jitter_us);
  std::uniform_real_distribution<double> uniform(0, 1);
  std::vector<StoredPacket> packets;
  std::vector<double> last_arrival(receivers.size(), 0);
  std::vector<std::uint16_t> bfee_count;
  for (const auto& receiver : receivers) bfee_count.push_back(receiver.bfee_count);
  double paused_s = 0;
  for (std::int64_t frame = 0; frame < transmitter.frames; ++frame) {
    paused_s += transmitter.pause_s(frame);
    const double access_s = transmitter.access_jitter_us > 0 ? access(random) * 1e-6 : 0;
    const double air_s = paused_s + static_cast<double>(frame) / transmitter.hz + access_s;
    for (std::uint8_t r = 0; r < receivers.size(); ++r) {
      const MadeUpReceiver& receiver = receivers[r];
      if (receiver.deaf(frame) || uniform(random) < receiver.loss) continue;
      const double delay_s = 1e-3 * (receiver.path_ms - receiver.jitter_ms * std::log(1 - uniform(random)));
      const double arrival_s = std::max(transmitter.start_s + air_s + delay_s, last_arrival[r]);
      last_arrival[r] = arrival_s;
      CsiRecord csi = made_up_csi(r, frame);
      const double nic_us = receiver.offset_us + air_s * 1e6 * (1 + receiver.skew_ppm * 1e-6);
      csi.timestamp_low = static_cast<std::uint32_t>(static_cast<std::int64_t>(std::floor(nic_us)));
      csi.bfee_count = bfee_count[r]++;
      StoredPacket packet{r, SteadyTime{from_seconds(arrival_s)}, transmitter.frame_record(frame), frame};
      append_bfee_record(csi, packet.bytes);
      packets.push_back(std::move(packet));
    }
  }
  std::stable_sort(packets.begin(), packets.end(),
                   [](const auto& a, const auto& b) { return a.arrival < b.arrival; });
  return packets;
}

/// Lets a packet be overtaken by the `by` next ones: it arrives with the last of them.
inline void delay_packet(std::vector<StoredPacket>& packets, std::size_t i, std::size_t by) {
  packets[i].arrival = packets[i + by].arrival;
  const auto at = packets.begin() + static_cast<std::ptrdiff_t>(i);
  std::rotate(at, at + 1, at + static_cast<std::ptrdiff_t>(by) + 1);
}
inline void repeat_packet(std::vector<StoredPacket>& packets, std::size_t i) {
  const StoredPacket copy = packets[i];
  packets.insert(packets.begin() + static_cast<std::ptrdiff_t>(i), copy);
}

/// Feeds packets as the loop does in a replay: a window is taken when a packet later than its end by `jitter`
/// has come, and at the end as long as there are slots that were filled.
inline std::vector<Window> run(FrontEnd& front_end, const std::vector<StoredPacket>& packets,
                               Nanoseconds jitter = std::chrono::milliseconds(30)) {
  std::vector<Window> windows;
  const auto take = [&] {
    windows.emplace_back();
    front_end.take(windows.back());
  };
  for (const StoredPacket& packet : packets) {
    while (front_end.next() && packet.arrival > front_end.next()->last_sample + jitter) take();
    front_end.add(packet.packet());
  }
  while (front_end.next() && front_end.next()->end_slot <= front_end.newest_slot()) take();
  return windows;
}

}  // namespace csipose::testing
