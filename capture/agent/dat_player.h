// capture/agent/dat_player.h - plays a .dat file as if its receiver heard it now, for testing without a NIC.
//
// Plain: the file's bytes as they are, paced by the file's own clock (capture/dat_file.h). What can be
// changed, and what is then no longer the recording's:
//   rate_hz          paced by this rate; NIC timestamps are rewritten to the times of playing
//   inject_counter   a frame of our own injector (CSIP) that counts is put before each CSI in place of the
//   recorded frame,
//                    unless the file has such frames already
//   loop             the file repeats for ever: with injected or continued CSIP counters, NIC timestamps and
//   bfee_count
//                    that go on from one round to the next
// A frame's number is its CSIP counter less that of the file's first frame, or else its place among the
// file's CSI records; so several agents agree on it when they play the same file, or files made of the same
// CSIP frames.
//
// A loop plays on the host's monotonic clock: round k begins at k times the file's period, whenever the agent
// was started. So all agents of a host that loop with the same rate are in step, also one that was restarted.
// C++17-clean.
#pragma once

#include <cstdint>
#include <vector>

#include "capture/dat_file.h"
#include "proto/bytes.h"
#include "proto/time.h"

namespace csipose {

struct PlayOptions {
  double rate_hz = 0;
  bool loop = false;
  bool inject_counter = false;
};

class DatPlayer {
 public:
  /// Throws SetupError when the file cannot be played (no usable clock and no rate, or no CSI at all).
  DatPlayer(const std::string& path, const PlayOptions& options);

  /// Playing begins now: a file at its first record, a loop where it is at this time.
  void start(SteadyTime now);
  /// When the next packet is to be sent. Requires !ended().
  SteadyTime next_at() const;
  /// The next packet's records (framed 0xC1, if any, and 0xBB); valid until the next call.
  ByteView take();
  bool ended() const { return next_ == plan_.size(); }
  std::size_t packets() const { return plan_.size(); }

 private:
  struct Planned {
    std::size_t packet;    // in file_.packets()
    std::uint64_t number;  // of the frame, from 0
    std::int64_t at_ns;    // from the start of the round
  };
  void plan();
  std::uint64_t round_number() const { return round_ * span_; }
  void append_frame(const Planned& planned);
  void append_csi(const Planned& planned);

  PlayOptions options_;
  DatFile file_;
  std::vector<Planned> plan_;
  bool has_csip_ = false;
  std::uint64_t span_ = 0;  // frame numbers of one round
  Nanoseconds period_{};
  SteadyTime start_{};
  std::uint64_t round_ = 0;
  std::size_t next_ = 0;
  std::vector<std::uint8_t> records_;
};

}  // namespace csipose
