// daemon/spsc_ring.h - values from one thread to one other, without lock, wait or allocation.
#pragma once

#include <atomic>
#include <bit>
#include <cstddef>
#include <vector>

namespace csipose {

/// One thread pushes, one reads. A full ring says no; what then happens is the caller's affair.
template <class Value>
class SpscRing {
 public:
  /// Room for at least `capacity` values, made here and never again.
  explicit SpscRing(std::size_t capacity) : slots_(std::bit_ceil(capacity)) {}

  /// Writer. False: full, nothing was written.
  bool push(const Value& value) {
    const std::size_t head = head_.load(std::memory_order_relaxed);
    if (head - tail_.load(std::memory_order_acquire) == slots_.size()) return false;
    slots_[head & (slots_.size() - 1)] = value;
    head_.store(head + 1, std::memory_order_release);
    return true;
  }
  /// Reader: the oldest value, or nullptr; it stays until pop().
  const Value* front() const {
    const std::size_t tail = tail_.load(std::memory_order_relaxed);
    return head_.load(std::memory_order_acquire) == tail ? nullptr : &slots_[tail & (slots_.size() - 1)];
  }
  /// Reader. Requires front().
  void pop() {
    tail_.fetch_add(1, std::memory_order_release);
    tail_.notify_one();
  }
  /// Writer: sleeps until a full ring has room. Only where waiting is allowed.
  void wait_for_room() const {
    const std::size_t full_at = head_.load(std::memory_order_relaxed) - slots_.size();
    tail_.wait(full_at, std::memory_order_acquire);
  }

 private:
  std::vector<Value> slots_;
  // Each counter on a cache line of its own: the threads would otherwise take it from each other at every
  // step.
  alignas(64) std::atomic<std::size_t> head_{0};
  alignas(64) std::atomic<std::size_t> tail_{0};
};

}  // namespace csipose
