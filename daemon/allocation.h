// daemon/allocation.h - operator new and page-aligned blocks of csiposed: they come from lists of the calling thread.
//
// oneDNN 2.6 makes some eight small objects with operator new per primitive it runs, and frees them at once; where there is
// no AVX-512, each matmul also packs an operand in a page-aligned block of posix_memalign. Linked into a program,
// allocation.cpp serves blocks of up to 520 bytes from a free list per thread and size, and page-aligned ones of up to 1 MiB
// from another, so that after the first windows the loop and the network's threads ask malloc, and hence the kernel, for
// nothing. Each list is short: a block beyond its limit goes back to malloc, so a thread that only frees what others made
// does not hoard. All blocks are glibc's own: who frees one, and with what, makes no difference.
// Sanitizer builds keep their own operator new and malloc: there this file is empty and kLoopAllocatorActive is false.
#pragma once

#include <cstdint>

namespace csipose {

#if defined(__SANITIZE_ADDRESS__) || defined(__SANITIZE_THREAD__)
inline constexpr bool kLoopAllocatorActive = false;
#else
inline constexpr bool kLoopAllocatorActive = true;
#endif

struct AllocationCounts {
  std::uint64_t requests = 0;     ///< calls of operator new, and for page-aligned blocks, on this thread
  std::uint64_t from_malloc = 0;  ///< of these, not served from a list
};
/// Of the calling thread, since its start.
AllocationCounts allocations_of_this_thread();
/// Requests that were not served from a list, all threads.
std::uint64_t allocations_from_malloc();

}  // namespace csipose
