// daemon/daemon.h - csiposed put together: source, loop, publisher, and the main thread that minds them.
#pragma once

#include <map>
#include <memory>

#include "daemon/config.h"
#include "daemon/log.h"
#include "proto/result.h"

namespace csipose {

class Daemon {
 public:
  /// Loads the model, opens source and sockets. Throws SetupError. `sources` is read again at a reload.
  /// SIGTERM, SIGINT, SIGHUP, SIGUSR1 and SIGUSR2 must be blocked in the calling thread, and no other thread
  /// be running.
  Daemon(ConfigSources sources, Config config, std::map<std::string, int> inherited_sockets, Log& log);
  ~Daemon();
  /// Until a signal or the end of a replay. Throws what broke source or loop.
  void run();

 private:
  struct State;
  std::unique_ptr<State> state_;
};

}  // namespace csipose
