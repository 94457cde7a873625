// daemon/truth_client.h - the truth socket of the simulator as a viewer reads it (proto/truth.h): where people really were
// at a given time.
#pragma once

#include <deque>
#include <string>

#include "proto/truth.h"
#include "proto/unix_socket.h"

namespace csipose {

class TruthClient {
 public:
  /// Connects and waits for the hello. Throws SetupError: nobody there, no right, or what answers is no simulator.
  explicit TruthClient(const std::string& path);

  const TruthHello& hello() const { return hello_; }
  /// Takes what has come; never waits. Throws SetupError when it is no truth.
  void drain();
  /// The instant nearest to `time`, if one lies within a packet's spacing of it; nullptr otherwise. Valid until drain().
  const Truth* at(UtcTime time) const;
  const Truth* newest() const { return kept_.empty() ? nullptr : &kept_.back(); }
  bool closed() const { return closed_; }

 private:
  bool cut_line(std::string& line);
  void receive(int flags);
  void take(const std::string& line);

  std::string path_;
  FileDescriptor fd_;
  std::string bytes_;
  TruthHello hello_;
  std::deque<Truth> kept_;  // of the last seconds, ascending in time
  bool closed_ = false;
};

}  // namespace csipose
