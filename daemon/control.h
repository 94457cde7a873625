// daemon/control.h - the control socket: JSON lines that start and stop recordings, reload the configuration,
// ask for the status.
//
// One request a line, one answer a line:
//   {"type":"record.start"}  ->  {"type":"record.start","file":"...","bytes":0,"active":true}
//   record.stop, record.list, reload, status likewise; a refusal is
//   {"type":"error","code":...,"text":...,"remedy":...}.
// The socket's group decides who may. docs/stream.md has the whole list.
#pragma once

#include <cstdint>
#include <functional>
#include <memory>
#include <string>
#include <vector>

#include "proto/status.h"
#include "proto/time.h"

namespace csipose {

struct RecordingEntry {
  std::string file;
  std::uint64_t bytes = 0;
  bool active = false;
};

/// What the daemon does when asked. A SetupError becomes the answer `error` with its words; one that is not
/// set answers that this daemon cannot.
struct ControlHandlers {
  std::function<RecordingEntry()> record_start, record_stop;
  std::function<std::vector<RecordingEntry>()> record_list;
  std::function<std::vector<std::string>()>
      reload;  ///< what has changed and what needs a restart, a sentence each
  std::function<Status()> status;
};

/// Carries out one request line (without newline) and gives the answer line (with). Whatever the line holds.
std::string answer_control_request(const std::string& line, const ControlHandlers& handlers);

class ControlServer {
 public:
  /// Listens at `path`, or at `inherited_fd` when that is not negative. Throws SetupError.
  ControlServer(const std::string& path, const std::string& group, int inherited_fd,
                ControlHandlers handlers);
  ~ControlServer();

  /// Answers requests on the calling thread for at most `timeout`, and comes back early when `wake_fd` can be
  /// read.
  void serve(Nanoseconds timeout, int wake_fd = -1);

 private:
  struct State;
  std::unique_ptr<State> state_;
};

/// The tool's side: sends {"type":TYPE} and gives the answer line. Throws SetupError with the daemon's words
/// when refused.
std::string ask_daemon(const std::string& control_socket, const std::string& type);

}  // namespace csipose
