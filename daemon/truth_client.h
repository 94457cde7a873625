// daemon/truth_client.h - the truth socket of the simulator as a viewer reads it (proto/truth.h): where people really were
// at a given time.
#pragma once

#include <string>

#include "daemon/truth_source.h"
#include "proto/unix_socket.h"

namespace csipose {

class TruthClient final : public TruthSource {
 public:
  /// Connects and waits for the hello. Throws SetupError: nobody there, no right, or what answers is no simulator.
  explicit TruthClient(const std::string& path);

  const TruthHello* hello() const override { return &hello_; }
  void drain() override;
  const Truth* at(UtcTime time) override;
  double age_s(const Truth& truth) const override;
  std::string silence() const override;
  bool closed() const { return closed_; }

 private:
  bool cut_line(std::string& line);
  void receive(int flags);
  void take(const std::string& line);

  std::string path_;
  FileDescriptor fd_;
  std::string bytes_;
  TruthHello hello_;
  bool closed_ = false;
};

}  // namespace csipose
