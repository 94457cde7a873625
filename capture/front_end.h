// capture/front_end.h - packets of three receivers in, aligned windows out: decode, sanitise, align, window.
//
// The one way from radio bytes to the network's tensor. The daemon, `csipose convert` and training all use
// this class, so what is trained is what is served. One thread; no allocation after construction; nothing
// here reads a clock: time comes in with the packets, so a recording gives the same windows at any speed.
//
// The grid. Every received frame gets a place on one line of transmit counters (recovered from the frame, or,
// where there is none, rebuilt from the receivers' clocks: aligner.h). Counters become grid slots
// (transmit_line.h) by
//     slot = floor((counter - counter0) * grid rate / transmit rate),
// so that equal rates use every frame once and a faster transmitter is thinned evenly; a pause of the
// transmitter moves the line on by the time that passed. The newest frame of a slot wins. A window is 20
// consecutive slots.
//
// The start. Until the transmit rate is known (33 frames of some receiver, unless it is configured) and until
// a receiver without counters has settled (32 frames), frames are held back and then placed as if nothing had
// been: none is lost, unless 64 of a receiver are held, when its oldest goes. A transmitter that starts anew
// loses 7 frames.
#pragma once

#include <array>
#include <cstdint>
#include <memory>
#include <optional>

#include "capture/features.h"
#include "capture/tx_counter.h"
#include "proto/packet.h"
#include "proto/window.h"

namespace csipose {

enum class AlignMethod : std::uint8_t { tx_counter, time };

struct FrontEndConfig {
  double grid_hz = 300;
  double tx_hz = 0;  ///< transmit rate; 0 = measured from the first packets
  int hop = 10;      ///< slots between windows
  int max_gap = 2;   ///< a missing sample is filled from at most this many slots before
  int stream = 0;    ///< which space-time stream is used
  PhaseMethod phase = PhaseMethod::joint;
  AmplitudeMethod amplitude = AmplitudeMethod::raw;
  CounterMethod counter = CounterMethod::automatic;
  AlignMethod align = AlignMethod::tx_counter;  ///< falls to time for a receiver whose frames hold no counter
  bool undo_permutation = true;
  bool undo_40mhz_rotation = true;
  Nanoseconds max_skew = std::chrono::milliseconds(20);
};

/// Counters and estimates of one receiver, since the start unless a name says otherwise.
struct ReceiverStats {
  std::uint64_t packets = 0;               ///< packets given to add()
  std::uint64_t records = 0;               ///< CSI records decoded
  std::uint64_t usable = 0;                ///< of these, fit for a window
  std::array<std::uint64_t, 16> faults{};  ///< by RecordFault (proto/record_stream.h)
  std::uint64_t unpaired_frames = 0;       ///< 0xC1 with no CSI after it
  std::uint64_t bad_fcs = 0;
  std::uint64_t no_counter = 0;   ///< usable records whose counter could not be told, nor their time
  std::uint64_t unplaced = 0;     ///< counter or time contradict the line of the other frames
  std::uint64_t lost_driver = 0;  ///< gaps of bfee_count: lost between driver and us
  std::uint64_t lost_air = 0;     ///< counters that another receiver got and this one did not, a second later
  std::uint64_t duplicates = 0;   ///< bfee_count or counter that came before
  std::uint64_t late = 0;         ///< came after its window was taken
  std::uint64_t filled = 0;       ///< samples repeated from an older one
  std::uint64_t clock_epochs = 0;  ///< times the NIC's clock started anew
  double rate_hz = 0;              ///< over the last second
  /// NIC clock against that of the first receiver heard: ahead by, faster by, scatter; NaN when not known.
  double offset_s = 0, skew_ppm = 0, residual_s = 0;
  double match_ratio = 0;  ///< records whose counter another receiver has too, 0..1
};

struct FrontEndStats {
  std::array<ReceiverStats, kReceivers> receivers{};
  std::uint64_t windows = 0, windows_masked = 0;  ///< taken; of these with a receiver masked
  double tx_hz = 0;                               ///< transmit rate in use; 0 = not yet known
  std::uint64_t pauses = 0, restarts = 0;         ///< of the transmitter
};

/// A window that can be had, and when its newest sample was (arrival of the fastest receiver's packet, by the
/// clock of Packet::arrival, smoothed: minimum filtered, so that it is steady to some tens of microseconds).
struct WindowDue {
  std::int64_t end_slot = 0;
  SteadyTime last_sample{};
};

class FrontEnd {
 public:
  explicit FrontEnd(const FrontEndConfig& config);
  ~FrontEnd();
  FrontEnd(const FrontEnd&) = delete;
  FrontEnd& operator=(const FrontEnd&) = delete;

  /// Decodes, pairs, sanitises and places one packet. Anything wrong with it is a counter, never an
  /// exception. Arrivals ascend over all receivers; one that runs back is taken for the newest so far.
  ///   cost: some 4 us at 3x1; no allocation
  void add(const Packet& packet);

  /// The next window in turn, known from the moment that the grid is (some packets in, transmit rate
  /// settled), and extrapolated when nothing comes any more; nullopt before.
  std::optional<WindowDue> next() const;

  /// Assembles the window of next() from what has arrived, and moves on by one hop. Requires next().
  void take(Window& window);

  /// Moves on, without making windows, until the next window's last sample is not before `time`; returns how
  /// many were passed over. For a loop that has fallen behind.
  std::uint64_t skip_before(SteadyTime time);

  /// The newest slot that some receiver has filled: a replay is over when next()->end_slot passes it.
  std::int64_t newest_slot() const;

  /// No more packets will come: counts the losses of the last second, which may still have arrived until now.
  void finish();

  const FrontEndStats& stats() const;

 private:
  struct State;
  std::unique_ptr<State> state_;
};

}  // namespace csipose
