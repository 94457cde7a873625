// daemon/recorder_thread.h - recordings, made on a thread that may wait for the disk.
//
// Packets come from the source's thread and frames from the loop's, each through a ring of its own: offering one never
// waits (but in a replay that loses nothing). A full ring drops and counts.
#pragma once

#include <atomic>
#include <memory>
#include <mutex>
#include <thread>

#include "capture/packet_ring.h"
#include "daemon/control.h"
#include "daemon/spsc_ring.h"
#include "proto/recording.h"
#include "proto/status.h"
#include "proto/wire.h"

namespace csipose {

class RecorderThread {
 public:
  struct Content {
    bool csi = true, pose = true;
  };
  RecorderThread(RecorderConfig config, Content content, bool lossless);
  ~RecorderThread();

  /// The source's thread, and the loop's.
  void offer(const Packet& packet);
  void offer(const PoseFrame& frame);

  // The main thread.
  void start_recording();
  void stop_recording();
  /// The next item begins a new file.
  void rotate();
  RecordingStatus status() const;
  /// Files in the folder of recordings, oldest name first.
  std::vector<RecordingEntry> list() const;

 private:
  void run();
  bool drain();
  bool drain_packet(SteadyTime now);
  bool drain_frame(SteadyTime now);

  const RecorderConfig config_;
  const Content content_;
  const bool lossless_;
  PacketRing packets_;
  SpscRing<PoseFrame> frames_;
  FrameEncoder encoder_;
  std::string encoded_;
  std::atomic<bool> active_{false}, stop_{false};
  std::atomic<std::uint64_t> frames_dropped_{0};
  mutable std::mutex mutex_;  ///< guards recorder_
  std::unique_ptr<Recorder> recorder_;
  std::thread thread_;
};

}  // namespace csipose
