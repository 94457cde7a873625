// daemon/watch.h - following the stream for a person or a pipe: what `csipose watch`, `replay` and `demo`
// have in common.
#pragma once

#include <cstdint>
#include <optional>
#include <string>

#include "daemon/error_meter.h"
#include "proto/time.h"
#include "proto/wire.h"

namespace csipose {

/// live: the screen of live_view.h; text: a line per frame; jsonl, protobuf: the stream's own messages.
enum class WatchFormat : std::uint8_t { live, text, jsonl, protobuf };

struct WatchOptions {
  std::string socket;
  std::string truth;  ///< the simulator's truth socket; empty = none
  std::string
      truth_recording;  ///< or the recording that is replayed, which is asked for its own; empty = none
  WatchFormat format = WatchFormat::text;
  float max_hz = 0;                     ///< 0 = every frame; the live view never asks for more than it draws
  std::optional<Nanoseconds> duration;  ///< ends by itself after this
  std::uint64_t frames = 0;             ///< ends by itself after that many; 0 = does not
};

/// How a watch ended.
struct WatchOutcome {
  std::uint64_t frames = 0, lost = 0, people = 0;  ///< got; told as lost; most in one frame
  std::string bye;           ///< what the daemon said at its end; empty = it did not end
  bool vanished = false;     ///< the socket closed without a word
  bool interrupted = false;  ///< a signal ended it
  Hello hello;
  std::optional<State> last_state;
  std::optional<ErrorSums> poses, guess;  ///< against the truth, if it was asked for
};

/// Follows until the daemon ends, the options say so, or SIGINT/SIGTERM. Throws SetupError.
WatchOutcome watch(const WatchOptions& options);

/// One sentence on the outcome, and throws SetupError (runtime) when it is not what was asked for.
std::string conclude(const WatchOptions& options, const WatchOutcome& outcome);

}  // namespace csipose
