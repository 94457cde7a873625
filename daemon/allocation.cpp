#include "daemon/allocation.h"

#include <malloc.h>

#include <array>
#include <atomic>
#include <cstdlib>
#include <new>

namespace csipose {
namespace {

constexpr std::size_t kClasses = 16, kLongestList = 64;
// glibc's blocks have 24, 40, 56 ... usable bytes (malloc.c: chunks are multiples of 16 with 8 bytes of
// overhead), so the size class of a block is read from the block itself and no header of ours is needed.
constexpr std::size_t kSmallest = 24, kStep = 16;

std::atomic<std::uint64_t> from_malloc_of_all{0};

struct Block {
  Block* next;
};

class ThreadLists {
 public:
  // Never destroyed as an object: a block may be freed while the thread's other destructors run.
  void* take(std::size_t size) {
    ++counts.requests;
    const std::size_t size_class = size <= kSmallest ? 0 : (size - kSmallest + kStep - 1) / kStep;
    if (size_class < kClasses && lists_[size_class] != nullptr) return pop(size_class);
    ++counts.from_malloc;
    from_malloc_of_all.fetch_add(1, std::memory_order_relaxed);
    return std::malloc(size_class < kClasses ? kSmallest + kStep * size_class : size);
  }

  void give(void* memory) {
    const std::size_t size_class = (malloc_usable_size(memory) - kSmallest) / kStep;
    if (closed_ || size_class >= kClasses || lengths_[size_class] >= kLongestList) return std::free(memory);
    lists_[size_class] = new (memory) Block{lists_[size_class]};
    ++lengths_[size_class];
  }

  void close() {
    closed_ = true;
    for (std::size_t c = 0; c < kClasses; ++c)
      while (lists_[c] != nullptr) std::free(pop(c));
  }

  AllocationCounts counts;

 private:
  void* pop(std::size_t size_class) {
    Block* block = lists_[size_class];
    lists_[size_class] = block->next;
    --lengths_[size_class];
    return block;
  }
  std::array<Block*, kClasses> lists_{};
  std::array<std::size_t, kClasses> lengths_{};
  bool closed_ = false;
};

constinit thread_local ThreadLists lists;

/// Gives a thread's blocks back when it ends.
struct ListsCloser {
  bool armed = false;
  ~ListsCloser() { lists.close(); }
};
thread_local ListsCloser closer;

}  // namespace

AllocationCounts allocations_of_this_thread() { return lists.counts; }
std::uint64_t allocations_from_malloc() { return from_malloc_of_all.load(std::memory_order_relaxed); }

}  // namespace csipose

#if !defined(__SANITIZE_ADDRESS__) && !defined(__SANITIZE_THREAD__)

void* operator new(std::size_t size) {
  csipose::closer.armed = true;
  while (true) {
    if (void* memory = csipose::lists.take(size)) return memory;
    const std::new_handler handler = std::get_new_handler();
    if (handler == nullptr) throw std::bad_alloc();
    handler();
  }
}

void operator delete(void* memory) noexcept {
  if (memory != nullptr) csipose::lists.give(memory);
}
void operator delete(void* memory, std::size_t) noexcept { operator delete(memory); }

#endif
