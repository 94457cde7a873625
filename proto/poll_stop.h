// proto/poll_stop.h - SIGTERM and SIGINT for programs whose loop waits in ppoll(). C++17-clean.
#pragma once

#include <csignal>

namespace csipose {

/// Signals to stop arrive only inside ppoll(), so none is missed between a look at wanted() and the wait. Threads begun
/// later never get them.
class PollStop {
 public:
  PollStop() {
    struct sigaction action {};
    action.sa_handler = [](int) { wanted_ = 1; };
    sigset_t stop;
    sigemptyset(&stop);
    for (const int signal : {SIGTERM, SIGINT}) {
      sigaction(signal, &action, nullptr);
      sigaddset(&stop, signal);
    }
    pthread_sigmask(SIG_BLOCK, &stop, &while_waiting_);
  }
  static bool wanted() { return wanted_ != 0; }
  const sigset_t* while_waiting() const { return &while_waiting_; }

 private:
  inline static volatile std::sig_atomic_t wanted_ = 0;
  sigset_t while_waiting_{};
};

}  // namespace csipose
