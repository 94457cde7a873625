// daemon/publisher.h - frames from the loop to every subscriber, on a thread of its own.
//
// The loop never waits: publish() copies the frame into a ring and wakes the thread. Each frame is encoded
// once per level and format that some client wants and the bytes are shared; each client has a ring of its
// own, and what happens when that is full is the client's choice (client_session.h). One socket, no other way
// in.
//
// Memory: a client holds at most queue_frames frames and the one being sent, 8 KiB each or less, and 64 KiB
// of answers.
#pragma once

#include <functional>
#include <memory>
#include <string>
#include <vector>

#include "daemon/client_session.h"
#include "proto/wire.h"

namespace csipose {

/// Where the publisher says what happens to clients. Called from its thread.
struct PublisherLog {
  std::function<void(const std::string&)> info, warn;
};

struct PublisherConfig {
  std::string socket_path;
  std::string group;      ///< empty = that of the process
  int inherited_fd = -1;  ///< a listening socket from systemd; then socket_path is for words only
  int max_clients = 64;
  StreamLimits limits;
  Hello hello;  ///< state is kept up to date from the frames
  std::vector<std::string> receiver_ids;
  std::size_t ring_frames = 64;  ///< between loop and publisher
  /// For a replay as fast as possible: publish() waits until every client has room, so that nothing is lost.
  /// A client that takes nothing is closed after limits.idle_close, and then waited for no more.
  bool lossless = false;
};

class Publisher {
 public:
  /// Listens and starts the thread. Throws SetupError when the socket cannot be made.
  Publisher(const PublisherConfig& config, PublisherLog log);
  /// finish("stopped") when that was not called.
  ~Publisher();

  /// One thread, the loop's. Wait-free (but lossless: see there); a full ring drops the frame and counts it.
  void publish(const PoseFrame& frame);
  /// Frames that publish() dropped, since the start. Any thread.
  std::uint64_t ring_dropped() const;
  /// Clients that get frames now. Any thread.
  int subscribers() const;

  /// Not for the loop's thread (locks). Sends the status to those who subscribed to it, and keeps it for
  /// those who will.
  void set_status(const Status& status);
  /// The last status that was set, with the publisher's own counts.
  Status status() const;
  /// Configuration reload: clients keep what they were granted, but for a lowered max_level.
  void configure(const StreamLimits& limits, int max_clients);

  /// Sends what is queued and bye{reason} to all, waits at most `patience` for them to take it, and ends the
  /// thread. Frames published afterwards go nowhere.
  void finish(const std::string& reason, Nanoseconds patience = std::chrono::seconds(1));

 private:
  struct State;
  std::unique_ptr<State> state_;
};

}  // namespace csipose
