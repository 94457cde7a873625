// capture/tx_counter.h - which transmitted frame was this? The counter by which receivers are aligned.
//
// Every receiver hears the same frame within nanoseconds, so the number that the transmitter gave it is exact
// where clocks are not. Four ways to a number, by what sent the frame:
//
//   csip        our injector: the body says "CSIP", session and a 64-bit counter
//   sequence16  csiread's and jiangzp's injectors: all 16 bits of sequence control count
//   lfsr        csitool's random_packets: bodies are windows of one fixed pseudo-random stream of 2,000,000
//               bytes; the place in the stream tells the frame
//   sequence12  an ordinary network stack: the upper 12 bits of sequence control, per transmitter and class
//
// Source: csitool-supplementary injection/random_packets.c, csiread's injector; LFSR measured on csiread's
// recording.
// Not here: counters of different wraps put on one line (aligner.h).
#pragma once

#include <array>
#include <cstdint>
#include <memory>
#include <optional>

#include "capture/mpdu.h"

namespace csipose {

/// How the transmit counter is recovered from a received 802.11 frame; `automatic` settles per receiver on
/// what it sees.
enum class CounterMethod : std::uint8_t { automatic, csip, sequence16, lfsr, sequence12, none };
const char* name(CounterMethod method);

struct TxCounter {
  std::uint64_t value = 0;        ///< below `modulus`
  std::uint64_t modulus = 0;      ///< where it wraps: 65536, 4096, or the injector's period; 0 = 2^64
  std::uint16_t session = 0;      ///< of csip: a new one says that the injector has started anew
  std::uint64_t transmit_ns = 0;  ///< of csip: transmitter's monotonic clock; 0 = not told
};

/// Bodies of csitool's random_packets.
class LfsrBodies {
 public:
  static constexpr std::uint32_t kStreamBytes = 2'000'000;
  LfsrBodies();
  ~LfsrBodies();

  /// Where in the stream `body` begins; nullopt when it is not of the stream.
  ///   requires  at least 8 bytes, all but the first 4 of which (at most 8) must follow from the first 4
  ///   cost      some 150 ns, no allocation
  std::optional<std::uint32_t> position(ByteView body) const;
  /// The frame whose body of this size begins there, below period(size); nullopt when none does.
  static std::optional<std::uint32_t> frame_at(std::uint32_t position, std::size_t body_size);
  /// After how many frames of this size the bodies repeat.
  static std::uint32_t period(std::size_t body_size);
  /// The body of a frame: `size` bytes from (frame * size) mod 2,000,000 on. For tests and generators; slow.
  static void fill(std::uint64_t frame, std::uint8_t* body, std::size_t size);

 private:
  struct Table;
  std::shared_ptr<const Table> table_;  ///< 0.5 MB, shared by all
};

/// Recovers counters of one receiver's frames.
///
/// `automatic` settles on evidence: the first frame that says CSIP settles csip; the first whose body follows
/// the LFSR settles lfsr; else 16 frames of one transmitter are looked at, and if their sequence control
/// counts up in small steps it is sequence16 when any fragment bit was set and sequence12 when none was.
/// Frames seen until then have no counter. It looks anew after 64 frames without counter.
class CounterRecovery {
 public:
  explicit CounterRecovery(CounterMethod method);

  /// The counter of a frame whose FCS held, where it can be told. Give it frames that CSI came with, not the
  /// beacons between them. No allocation.
  std::optional<TxCounter> recover(const Mpdu& frame);
  /// What is in use: never changes unless automatic was asked for, `automatic` while that has not settled.
  CounterMethod method() const { return method_; }

 private:
  static constexpr std::size_t kEvidenceFrames = 16;
  struct Flow {
    std::array<std::uint8_t, 6> transmitter{};
    std::uint8_t traffic_class = 0;
    bool known = false;
  };

  std::optional<TxCounter> by_method(CounterMethod method, const Mpdu& frame);
  std::optional<TxCounter> by_lfsr(const Mpdu& frame) const;
  std::optional<TxCounter> by_sequence12(const Mpdu& frame);
  std::optional<TxCounter> settle(const Mpdu& frame);
  CounterMethod judge_sequence() const;
  bool of_the_flow(const Mpdu& frame);

  bool automatic_;
  CounterMethod method_;
  LfsrBodies lfsr_;
  Flow flow_;
  std::array<std::uint16_t, kEvidenceFrames> evidence_{};
  std::size_t evidence_count_ = 0;
  unsigned failures_ = 0;  ///< frames in a row without a counter
};

}  // namespace csipose
