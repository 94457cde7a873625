// daemon/watch_options.h - the options of `csipose watch`, which replay and demo take too.
#pragma once

#include <cstdint>
#include <string>

#include "daemon/watch.h"

namespace CLI {
class App;
}

namespace csipose {

struct WatchWords {
  std::string format, truth;
  double duration_s = 0;
  std::uint64_t frames = 0;
  float max_hz = 0;
};
/// `words` must outlive the parsing.
void add_watch_options(CLI::App& command, WatchWords& words);
/// Throws SetupError when a live screen is asked for and there is no terminal.
WatchOptions watch_options(const WatchWords& words, const std::string& socket);
/// Watches and says on stderr how it ended.
void watch_and_conclude(const WatchOptions& options);

}  // namespace csipose
