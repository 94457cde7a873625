// daemon/allocation.h - operator new of csiposed: small blocks come from lists of the calling thread.
//
// oneDNN 2.6 makes some eight small objects with operator new per primitive it runs, and frees them at once.
// Linked into a program, allocation.cpp serves blocks of up to 264 bytes from a free list per thread and
// size, so that after the first windows the loop and the network's threads ask malloc, and hence the kernel,
// for nothing. Each list is short: a block beyond its limit goes back to malloc, so a thread that only frees
// what others made does not hoard. Sanitizer builds keep their own operator new: there this file is empty and
// kLoopAllocatorActive is false.
#pragma once

#include <cstdint>

namespace csipose {

#if defined(__SANITIZE_ADDRESS__) || defined(__SANITIZE_THREAD__)
inline constexpr bool kLoopAllocatorActive = false;
#else
inline constexpr bool kLoopAllocatorActive = true;
#endif

struct AllocationCounts {
  std::uint64_t requests = 0;     ///< calls of operator new on this thread
  std::uint64_t from_malloc = 0;  ///< of these, not served from a list
};
/// Of the calling thread, since its start.
AllocationCounts allocations_of_this_thread();
/// Calls of malloc by operator new, all threads.
std::uint64_t allocations_from_malloc();

}  // namespace csipose
