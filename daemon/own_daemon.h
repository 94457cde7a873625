// daemon/own_daemon.h - a csiposed that the tool starts for itself, in a folder of its own, and ends again.
#pragma once

#include <string>
#include <vector>

#include "daemon/child_process.h"

namespace csipose {

class OwnDaemon {
 public:
  /// Starts csiposed with this tool's --config and --set, and then `settings` ("section.key=value"); waits
  /// until its pose socket answers. Throws SetupError with the daemon's last words when it does not.
  explicit OwnDaemon(const std::vector<std::string>& settings);

  std::string socket() const { return folder_ / "pose.sock"; }
  const PrivateFolder& folder() const { return folder_; }
  /// Asks it to end, or waits when it is ending by itself. Throws SetupError when it ended with a failure.
  void finish(bool is_ending);

 private:
  void wait_for_socket();
  [[noreturn]] void fail(int status) const;

  PrivateFolder folder_;
  ChildProcess process_;
};

/// Text as a TOML string, and a list of them: ["a", "b \"c\""].
std::string toml_text(const std::string& text);
std::string toml_list(const std::vector<std::string>& texts);

}  // namespace csipose
