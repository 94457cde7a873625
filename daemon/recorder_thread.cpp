#include "daemon/recorder_thread.h"

#include <algorithm>
#include <filesystem>

#include "proto/time.h"

namespace csipose {
namespace {

namespace fs = std::filesystem;

constexpr std::size_t kPacketBytes = 8 << 20, kFrames = 64;
constexpr auto kDrainEvery = std::chrono::milliseconds(20);
constexpr auto kLongestWait = std::chrono::seconds(1);
constexpr int kBatch = 256;  // items written before others may have the lock

}  // namespace

RecorderThread::RecorderThread(RecorderConfig config, Content content, bool lossless)
    : config_(std::move(config)),
      content_(content),
      lossless_(lossless),
      packets_(kPacketBytes),
      frames_(kFrames),
      encoder_({config_.info.receivers.begin(), config_.info.receivers.end()}),
      thread_([this] { run(); }) {}

RecorderThread::~RecorderThread() {
  stop_ = true;
  thread_.join();
}

void RecorderThread::offer(const Packet& packet) {
  if (!content_.csi || !active_.load(std::memory_order_relaxed)) return;
  if (lossless_)
    packets_.push_wait(packet, stop_);
  else
    packets_.push(packet);
}

void RecorderThread::offer(const PoseFrame& frame) {
  if (!content_.pose || !active_.load(std::memory_order_relaxed)) return;
  while (!frames_.push(frame)) {
    if (!lossless_ || stop_) return void(frames_dropped_.fetch_add(1, std::memory_order_relaxed));
    std::this_thread::sleep_for(std::chrono::microseconds(100));
  }
}

void RecorderThread::start_recording() {
  const std::lock_guard lock(mutex_);
  if (!recorder_) recorder_ = std::make_unique<Recorder>(config_);
  active_ = true;
}

void RecorderThread::stop_recording() {
  active_ = false;
  // What was offered is kept, unless the disk takes too long for a daemon that has to end.
  const SteadyTime deadline = steady_now() + kLongestWait;
  while ((!packets_.empty() || frames_.front() != nullptr) && steady_now() < deadline)
    std::this_thread::sleep_for(kDrainEvery);
  const std::lock_guard lock(mutex_);
  if (recorder_) recorder_->rotate();
}

void RecorderThread::rotate() {
  const std::lock_guard lock(mutex_);
  if (recorder_) recorder_->rotate();
}

void RecorderThread::run() {
  while (!stop_.load(std::memory_order_relaxed))
    if (!drain()) std::this_thread::sleep_for(kDrainEvery);
  while (drain()) {
  }
}

/// False when both rings were empty.
bool RecorderThread::drain() {
  const std::lock_guard lock(mutex_);
  const SteadyTime now = steady_now();
  bool any = false;
  for (int i = 0; i < kBatch; ++i) {
    const bool packet = drain_packet(now), frame = drain_frame(now);
    any = any || packet || frame;
  }
  if (recorder_) recorder_->tick(now);
  return any;
}

bool RecorderThread::drain_packet(SteadyTime now) {
  Packet packet;
  if (!packets_.front(packet)) return false;
  if (recorder_) recorder_->add(packet, now);
  packets_.pop();
  return true;
}

bool RecorderThread::drain_frame(SteadyTime now) {
  const PoseFrame* frame = frames_.front();
  if (frame == nullptr) return false;
  encoder_.encode_body(*frame, Level::pose, Format::protobuf, encoded_);
  if (recorder_)
    recorder_->add(PoseItem{encoded_, frame->seq, SteadyTime{Nanoseconds{frame->mono_ns}}, frame->published},
                   now);
  frames_.pop();
  return true;
}

RecordingStatus RecorderThread::status() const {
  RecordingStatus status;
  status.active = active_;
  const std::lock_guard lock(mutex_);
  if (!recorder_) return status;
  const Recorder::Status inner = recorder_->status();
  status.file = inner.file;
  status.bytes = inner.bytes;
  status.errors = inner.errors + inner.dropped + packets_.dropped() + frames_dropped_;
  return status;
}

std::vector<RecordingEntry> RecorderThread::list() const {
  const std::string open_file = status().file;
  std::vector<RecordingEntry> entries;
  std::error_code none;
  for (const auto& entry : fs::directory_iterator(config_.folder, none))
    if (entry.path().extension() == ".mcap")
      entries.push_back({entry.path().string(), entry.file_size(none), entry.path().string() == open_file});
  std::ranges::sort(entries, {}, &RecordingEntry::file);
  return entries;
}

}  // namespace csipose
