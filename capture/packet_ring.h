// capture/packet_ring.h - packets from one thread to one other, through memory that is there from the start.
//
// A ring of bytes: each packet is a fixed header and its records, 8-byte aligned and never split; what is
// left at the end of the memory is skipped. No lock, no allocation, no system call (but push_wait's naps).
// Full means dropped and counted, because the radio does not wait either; a replay as fast as possible uses
// push_wait and loses nothing.
#pragma once

#include <atomic>
#include <bit>
#include <cassert>
#include <cstring>
#include <memory>
#include <thread>

#include "proto/packet.h"

namespace csipose {

class PacketRing {
 public:
  /// `bytes` is rounded up to a power of two. A packet takes 32 bytes and its records; one that takes more
  /// than half of the ring is always dropped (of legal packets, none in a ring of 512 KiB).
  explicit PacketRing(std::size_t bytes)
      : size_(std::bit_ceil(bytes)),
        memory_(std::make_unique<std::uint64_t[]>(size_ / sizeof(std::uint64_t))) {
    assert(bytes >= 1024);
  }

  /// Copies a packet in. False: full, dropped, counted. The producer's thread only; wait-free.
  bool push(const Packet& packet) {
    if (try_push(packet)) return true;
    dropped_.fetch_add(1, std::memory_order_relaxed);
    return false;
  }

  /// Waits for room, looking every 50 us, until `stop` says that nobody will make any. False: stopped, or too
  /// large.
  bool push_wait(const Packet& packet, const std::atomic<bool>& stop) {
    while (!try_push(packet)) {
      if (entry_bytes(packet) > size_ / 2) return push(packet);
      if (stop.load(std::memory_order_relaxed)) return false;
      std::this_thread::sleep_for(std::chrono::microseconds(50));
    }
    return true;
  }

  /// The oldest packet, if any; its records stay valid until pop(). The consumer's thread only; wait-free.
  bool front(Packet& packet) {
    const std::uint64_t head = head_.load(std::memory_order_acquire);
    std::uint64_t tail = tail_.load(std::memory_order_relaxed);
    if (tail == head) return false;
    if (records_at(tail) == kSkip) {  // never the last thing written: a packet follows it
      tail += size_ - tail % size_;
      tail_.store(tail, std::memory_order_release);
    }
    Header header;
    std::memcpy(&header, at(tail), sizeof header);
    packet = {header.receiver, SteadyTime(Nanoseconds(header.arrival_ns)),
              UtcTime(Nanoseconds(header.utc_ns)), ByteView(at(tail) + sizeof header, header.size)};
    return true;
  }
  /// Gives the memory of front()'s packet back. Requires a front() that was true.
  void pop() {
    const std::uint64_t tail = tail_.load(std::memory_order_relaxed);
    tail_.store(tail + round_up(sizeof(Header) + records_at(tail)), std::memory_order_release);
  }

  /// Packets dropped because the ring was full. Any thread.
  std::uint64_t dropped() const { return dropped_.load(std::memory_order_relaxed); }
  bool empty() const {
    return head_.load(std::memory_order_acquire) == tail_.load(std::memory_order_acquire);
  }

 private:
  struct Header {
    std::uint32_t size;  // of the records; kSkip: go on at the start of the memory
    std::uint8_t receiver;
    std::int64_t arrival_ns, utc_ns;
  };
  static constexpr std::uint32_t kSkip = 0xFFFFFFFF;

  static std::uint64_t round_up(std::uint64_t bytes) { return (bytes + 7) & ~std::uint64_t{7}; }
  static std::uint64_t entry_bytes(const Packet& packet) {
    return round_up(sizeof(Header) + packet.records.size());
  }
  std::uint8_t* at(std::uint64_t place) const {
    return reinterpret_cast<std::uint8_t*>(memory_.get()) + (place & (size_ - 1));
  }
  std::uint32_t records_at(std::uint64_t place) const {
    std::uint32_t size;
    std::memcpy(&size, at(place), sizeof size);
    return size;
  }

  bool try_push(const Packet& packet) {
    const std::uint64_t need = entry_bytes(packet);
    std::uint64_t head = head_.load(std::memory_order_relaxed);
    const std::uint64_t tail = tail_.load(std::memory_order_acquire);
    const std::uint64_t to_end = size_ - head % size_;
    const std::uint64_t skip = to_end < need ? to_end : 0;
    if (need > size_ / 2 || head + skip + need - tail > size_) return false;
    if (skip > 0) std::memcpy(at(head), &kSkip, sizeof kSkip);
    head += skip;
    const Header header = {static_cast<std::uint32_t>(packet.records.size()), packet.receiver,
                           ns(packet.arrival), ns(packet.arrival_utc)};
    std::memcpy(at(head), &header, sizeof header);
    if (!packet.records.empty())
      std::memcpy(at(head) + sizeof header, packet.records.data(), packet.records.size());
    head_.store(head + need, std::memory_order_release);
    return true;
  }

  const std::uint64_t size_;
  const std::unique_ptr<std::uint64_t[]> memory_;
  // Bytes ever written and given back; on cache lines of their own, since two threads write them.
  alignas(64) std::atomic<std::uint64_t> head_{0};
  alignas(64) std::atomic<std::uint64_t> tail_{0};
  alignas(64) std::atomic<std::uint64_t> dropped_{0};
};

}  // namespace csipose
