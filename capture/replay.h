// capture/replay.h - packets of a recording: one .mcap, or one .dat file per receiver.
//
// The source gives packets as fast as it is asked, with their recorded times; whoever wants 1x sleeps. Times
// are on one steady line that begins at 0 (.dat) or where it was recorded (.mcap).
//
// Several .dat files. With side files their UTC stamps are the common line. Without, every file has only its
// own NIC's clock; but all receivers heard the same frames, bit for bit, so where files hold frames (0xC1)
// the first file's clock is the common line: a packet whose frame the first file has too gets that one's
// time, and the others keep their distance to the last such packet. Files without frames begin at the same
// instant, for want of anything better. UTC of a .dat file without side file is not known: it counts from
// 1970, which nobody will mistake for a date.
#pragma once

#include <memory>
#include <string>
#include <vector>

#include "capture/source.h"

namespace csipose {

struct ReplayConfig {
  std::vector<std::string>
      files;           ///< one .mcap, or up to three .dat: file i is receiver i (the same one may come again)
  double rate_hz = 0;  ///< of .dat files whose NIC clock is unusable; 0 = by the clock
  bool loop = false;   ///< begin again at the end; to the front end a transmitter that was restarted
};

/// Throws SetupError with words when a file cannot be replayed. kind() is REPLAY, whatever was recorded.
std::unique_ptr<PacketSource> open_replay(const ReplayConfig& config);

}  // namespace csipose
