// daemon/snapshot.h - the newest value of one thread, for another: wait-free on both sides, nothing torn,
// nothing queued.
//
// A triple buffer: the writer fills one slot, the reader reads another, the third lies between them and
// changes hands by one atomic exchange. The loop hands out its counters and takes in settings this way,
// without lock or allocation.
#pragma once

#include <array>
#include <atomic>
#include <cstdint>

namespace csipose {

template <class T>
class Snapshot {
 public:
  /// Writer's side: change back(), then publish(). back() holds some older value until it is written.
  T& back() { return slots_[back_]; }
  void publish() { back_ = between_.exchange(back_ | kFresh, std::memory_order_acq_rel) & kIndex; }

  /// Reader's side: true when a newer value than the last one came; front() is it.
  bool refresh() {
    if ((between_.load(std::memory_order_relaxed) & kFresh) == 0) return false;
    front_ = between_.exchange(front_, std::memory_order_acq_rel) & kIndex;
    return true;
  }
  const T& front() const { return slots_[front_]; }

 private:
  static constexpr std::uint8_t kIndex = 3, kFresh = 4;
  std::array<T, 3> slots_{};
  std::uint8_t back_ = 0, front_ = 1;  // one thread each
  std::atomic<std::uint8_t> between_{2};
};

}  // namespace csipose
